"""What the agents have in common: geometry, splines, calibration, the runtime, recordings, both scene renderers."""
