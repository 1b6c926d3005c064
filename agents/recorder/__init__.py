"""The recorder: every recorded topic of a rig to MCAP, with its losses."""
