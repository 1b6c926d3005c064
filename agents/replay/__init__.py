"""Replay: a recorded session on the live keys again, or through one agent in this process."""
