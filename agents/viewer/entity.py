"""What every mapping gives: paths with what to log there, and when it was so."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

Entity = tuple[str, Sequence[rr.AsComponents]]

HALF_PX = 0.5
"""Integers are pixel centres with us, and pixel corners with Rerun."""


EARLIEST_NS = np.iinfo(np.int64).min + 1
LAST_FRAME = np.iinfo(np.int64).max
"""That Rerun can number; on the wire there are more."""


@dataclass(frozen=True)
class Moment:
    """When something was so: nanoseconds since 1970, and the frame it descends from, if any."""

    capture_ns: int
    frame: int | None = None

    def __post_init__(self) -> None:
        # the smallest number of all is no time to NumPy, but "not a time"
        object.__setattr__(self, "capture_ns", max(self.capture_ns, EARLIEST_NS))
        if self.frame is not None and self.frame > LAST_FRAME:
            object.__setattr__(self, "frame", int(LAST_FRAME))
