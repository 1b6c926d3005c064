"""The commands that work on a running rig."""
