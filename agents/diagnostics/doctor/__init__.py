"""What is wrong with a rig, a pair of images, or this machine, each with its remedy."""
