"""Simulated trials of pulling a thread through tissue until its tail has a length that is asked for."""
