"""The names of the segmenters, for whoever configures one and runs none: messages take long to load, and stay out."""

GIVEN_MASKS = "mask"
"""As observations say it (schemas/messages/thread.py)."""
THRESHOLD, NETWORK = "threshold", "network"
PROMPTABLE = "promptable"
"""Needs the files of a network, which a user supplies."""
SEGMENTER_NAMES = (GIVEN_MASKS, THRESHOLD, NETWORK, PROMPTABLE)
