"""The names of the reconstruction methods, for whoever configures one and runs none."""

PAPER, REFINED = "paper", "refined"
DEFAULT_METHOD = REFINED
MATCHING_METHODS = frozenset({PAPER})
"""Those that need matched pixels; the others start from the centrelines."""
