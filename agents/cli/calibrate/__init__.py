"""`suturegrasp calibrate`: a stereo camera, or a camera and an arm."""
