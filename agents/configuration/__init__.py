"""The configuration of a rig: its file's sections, what they are checked for, and which host this machine is."""
