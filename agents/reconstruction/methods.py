"""The reconstruction methods by name: each takes ordered observations to a thread, and never raises for any of them."""

from collections.abc import Callable

from agents.reconstruction.paper import METHOD, reconstruct_paper
from schemas.messages import ThreadObservations, ThreadReconstruction

Method = Callable[[ThreadObservations], ThreadReconstruction]

METHODS: dict[str, Method] = {METHOD: reconstruct_paper}
DEFAULT_METHOD = METHOD
