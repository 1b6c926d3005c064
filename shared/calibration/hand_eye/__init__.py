"""Where a robot's base is before the camera: read from files, and estimated from what was seen of its tool."""
