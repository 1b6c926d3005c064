"""The configuration of a rig, and the agents that are built from it."""
