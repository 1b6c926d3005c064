"""The needle agent: lines around a needle in, its pose out."""

from collections.abc import Iterable

from agents.needle import NeedleConfig
from agents.needle.pose import needle_pose
from schemas.messages import NeedlePose
from schemas.topics import NEEDLE, NEEDLE_SEEN
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick


class Needle(Agent):
    """Finds the needle in every message of perception, and goes on from its last pose alone."""

    kind = "needle"
    config: NeedleConfig
    inputs = (Input(NEEDLE_SEEN, only_newest_counts=True),)
    outputs = (NEEDLE,)
    goes_on_from = NEEDLE

    def __init__(self, config: NeedleConfig | None = None) -> None:
        self.config = config or NeedleConfig()
        self._last: NeedlePose | None = None

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output]:
        """A pose for each message, failed ones included."""
        if not isinstance(arrived, Received):
            return
        if arrived.topic is NEEDLE:
            self._last = arrived.message
        else:
            self._last = needle_pose(arrived.message, self._last, self.config.radius_mm, self.config.arc_deg)
            yield Output(NEEDLE, self._last)
