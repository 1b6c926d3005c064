"""The reconstruction agent: observations in, thread out."""

from collections.abc import Iterable
from dataclasses import dataclass

from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.reconstruction.methods import METHODS, TRACKERS
from schemas.messages import CommandAnswer, ThreadReconstruction
from schemas.topics import OBSERVATIONS, THREAD
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick


@dataclass(frozen=True)
class ReconstructionConfig:
    """Which method makes threads, and whether it goes on from its last one."""

    method: str
    tracking: bool


class Reconstruction(Agent):
    """Runs one method on every message of observations.

    With tracking, and a method that can, it goes on from its last thread, in which all lies that it keeps. Without, it
    keeps nothing from one message to the next.
    """

    kind = "reconstruction"
    config: ReconstructionConfig
    inputs = (Input(OBSERVATIONS, only_newest_counts=True),)
    outputs = (THREAD,)

    def __init__(self, method: str = DEFAULT_METHOD, tracking: bool = True) -> None:
        self.config = ReconstructionConfig(method, tracking)
        self._method = METHODS[method]
        self._tracker = TRACKERS.get(method) if tracking else None
        self.goes_on_from = THREAD if self._tracker else None
        self._last: ThreadReconstruction | None = None

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """One thread for each message of observations, failed ones included."""
        if not isinstance(arrived, Received):
            return
        if arrived.topic is THREAD:
            self._last = arrived.message
        elif self._tracker is None:
            yield Output(THREAD, self._method(arrived.message))
        else:
            self._last = self._tracker(arrived.message, self._last)
            yield Output(THREAD, self._last)
