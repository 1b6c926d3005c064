"""The names of the segmenters, for whoever configures one and runs none."""

from schemas.messages import GIVEN_MASKS

THRESHOLD, NETWORK = "threshold", "network"
PROMPTABLE = "promptable"
"""Needs the files of a network, which a user supplies."""
SEGMENTER_NAMES = (GIVEN_MASKS, THRESHOLD, NETWORK, PROMPTABLE)

__all__ = ["GIVEN_MASKS", "NETWORK", "PROMPTABLE", "SEGMENTER_NAMES", "THRESHOLD"]
