"""The camera agent: where stereo images come from."""

LARGEST_IMAGE_PIXELS = 1 << 26
"""Two 8K images side by side; a file that claims more is damaged, or made to exhaust the memory."""
