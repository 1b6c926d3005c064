"""How a rig fares, in plain words."""
