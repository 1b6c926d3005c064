"""`suturegrasp reconstruct`: one pair of images becomes a thread."""
