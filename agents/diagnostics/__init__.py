"""How a rig fares, and what is wrong with it: `status` watches, `doctor` looks once, each in plain words."""
