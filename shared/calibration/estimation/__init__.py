"""A stereo calibration estimated from views of a board, and one checked against them."""
