"""The names of the reconstruction methods, for whoever configures one and runs none."""

PAPER, REFINED = "paper", "refined"
METHOD_NAMES = (PAPER, REFINED)
DEFAULT_METHOD = REFINED
MATCHING_METHODS = frozenset({PAPER})
"""Those that need matched pixels; the others start from the centrelines."""
