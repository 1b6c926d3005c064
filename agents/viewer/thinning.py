"""Which messages of a fast topic are shown: the first in each period of their own time.

Periods are counted from 1970, so topics that descend from one frame keep the same frames.
"""

from schemas.topics import (
    FRAME_NOTICE,
    FRAMES,
    HEARTBEAT,
    OBSERVATIONS,
    REPLAY_CLOCK,
    ROBOT_STATE,
    SIMULATOR_STATE,
    THREAD,
    Topic,
)

MOST_PER_SECOND = {
    FRAMES: 10,
    OBSERVATIONS: 10,
    THREAD: 10,
    ROBOT_STATE: 20,
    SIMULATOR_STATE: 10,
    FRAME_NOTICE: 2,
    HEARTBEAT: 2,
    REPLAY_CLOCK: 2,
}
"""What an eye can follow, and a machine with room can spare."""

IN_A_FULL_MACHINE = 5
"""Of what descends from frames, which is nearly all of a viewer's work."""

BY_FRAME = (FRAMES, OBSERVATIONS, THREAD)
"""Thinned by when their frame was seen; all others by when they were published, before they are decoded."""


class Thinning:
    """Remembers the last period that each key had a message shown in."""

    def __init__(self) -> None:
        self.there_is_room = True
        self._last: dict[str, int] = {}

    def keeps(self, topic: Topic, key: str, at_ns: int) -> bool:
        """Whether a message of that time is shown."""
        if topic not in MOST_PER_SECOND:
            return True
        most = MOST_PER_SECOND[topic]
        if topic in BY_FRAME and not self.there_is_room:
            most = IN_A_FULL_MACHINE
        period = at_ns * most // 1_000_000_000
        if self._last.get(key) == period:
            return False
        self._last[key] = period
        return True
