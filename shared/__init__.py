"""What the agents have in common: geometry, splines, calibration, the light scene renderer."""
