"""`suturegrasp status`: how a rig fares, in plain words."""
