"""The reconstruction agent: observations in, thread out."""

from collections.abc import Iterable

from agents.reconstruction.methods import DEFAULT_METHOD, METHODS
from schemas.messages import CommandAnswer
from schemas.topics import MAIN, OBSERVATIONS, THREAD, Topic
from shared.runtime.agent import Command, Input, Output, Received, Tick


class Reconstruction:
    """Runs one method on every message of observations; it keeps nothing from one to the next."""

    kind = "reconstruction"
    instance = MAIN
    inputs = (Input(OBSERVATIONS, only_newest_counts=True),)
    outputs = (THREAD,)
    commands: tuple[Topic, ...] = ()
    tick_hz = None

    def __init__(self, method: str = DEFAULT_METHOD) -> None:
        self._method = METHODS[method]

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """One thread for each message of observations, failed ones included."""
        if isinstance(arrived, Received):
            yield Output(THREAD, self._method(arrived.message))
