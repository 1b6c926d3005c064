"""The names of the segmenters, for whoever configures one and runs none."""

GIVEN_MASKS, THRESHOLD, RIDGE = "mask", "threshold", "ridge"
SEGMENTER_NAMES = (GIVEN_MASKS, THRESHOLD, RIDGE)
