"""Simulated trials of grasps, as the paper did: what is tried, how a trial goes, what it all comes to."""
