"""The reconstruction methods by name: each takes ordered observations to a thread, and never raises for any of them."""

from collections.abc import Callable

from agents.reconstruction import paper
from agents.reconstruction.refined import method as refined
from agents.reconstruction.refined.tracking import track_refined
from schemas.messages import ThreadObservations, ThreadReconstruction

Method = Callable[[ThreadObservations], ThreadReconstruction]
Tracker = Callable[[ThreadObservations, ThreadReconstruction | None], ThreadReconstruction]
"""Goes on from the last reconstruction, and does what the method does where there is none."""

METHODS: dict[str, Method] = {paper.METHOD: paper.reconstruct_paper, refined.METHOD: refined.reconstruct_refined}
TRACKERS: dict[str, Tracker] = {refined.METHOD: track_refined}
DEFAULT_METHOD = refined.METHOD
MATCHING_METHODS = frozenset({paper.METHOD})
"""Those that need matched pixels; the others start from the centrelines."""
