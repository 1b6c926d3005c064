"""Agents built from a rig's configuration, and run as the processes of a rig."""
