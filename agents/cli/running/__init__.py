"""The processes of a rig, started and watched."""
