"""The reconstruction methods by name: each takes ordered observations to a thread, and never raises for any of them."""

from collections.abc import Callable

from agents.reconstruction import paper
from agents.reconstruction.method_names import PAPER, REFINED
from agents.reconstruction.refined import method as refined
from agents.reconstruction.refined.strands import with_strands
from agents.reconstruction.refined.tracking import track_refined
from schemas.messages import ThreadObservations, ThreadReconstruction

Method = Callable[[ThreadObservations], ThreadReconstruction]
Tracker = Callable[[ThreadObservations, ThreadReconstruction | None], ThreadReconstruction]
"""Goes on from the last reconstruction, and does what the method does where there is none."""


def _refined(observations: ThreadObservations) -> ThreadReconstruction:
    return with_strands(refined.reconstruct_refined(observations), observations)


def _tracked(observations: ThreadObservations, last: ThreadReconstruction | None) -> ThreadReconstruction:
    return with_strands(track_refined(observations, last), observations)


METHODS: dict[str, Method] = {PAPER: paper.reconstruct_paper, REFINED: _refined}
TRACKERS: dict[str, Tracker] = {REFINED: _tracked}
