"""`suturegrasp doctor`: what is wrong with a rig, a pair of images, or this machine."""
