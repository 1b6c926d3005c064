"""The names of the segmenters, for whoever configures one and runs none."""

GIVEN_MASKS, THRESHOLD, NETWORK = "mask", "threshold", "network"
PROMPTABLE = "promptable"
"""Needs the files of a network, which a user supplies."""
SEGMENTER_NAMES = (GIVEN_MASKS, THRESHOLD, NETWORK, PROMPTABLE)
