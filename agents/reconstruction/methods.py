"""The reconstruction methods by name: each takes ordered observations to a thread, and never raises for any of them."""

from collections.abc import Callable

from agents.reconstruction import paper
from agents.reconstruction.refined import method as refined
from schemas.messages import ThreadObservations, ThreadReconstruction

Method = Callable[[ThreadObservations], ThreadReconstruction]

METHODS: dict[str, Method] = {paper.METHOD: paper.reconstruct_paper, refined.METHOD: refined.reconstruct_refined}
DEFAULT_METHOD = refined.METHOD
MATCHING_METHODS = frozenset({paper.METHOD})
"""Those that need matched pixels; the others start from the centrelines."""
