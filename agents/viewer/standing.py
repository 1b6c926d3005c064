"""What stands in the view as it stood: it is logged again once a second, not ten times.

Once a second, so that a viewer that connects late finds it: its server forgets what is older than its memory.
"""

from collections.abc import Sequence

import rerun as rr

from agents.viewer.moment import Moment

AGAIN_NS = 1_000_000_000
DRAWN = (
    rr.Arrows3D,
    rr.Boxes2D,
    rr.Capsules3D,
    rr.Clear,
    rr.GraphEdges,
    rr.GraphNodes,
    rr.LineStrips2D,
    rr.LineStrips3D,
    rr.Points2D,
    rr.Points3D,
)
"""What is drawn from it is the same, however often it is logged; a line of the log is not."""


class Standing:
    """Remembers what was last logged of each entity, and when."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[Moment, Sequence[rr.AsComponents]]] = {}

    def stands(self, path: str, moment: Moment, archetypes: Sequence[rr.AsComponents]) -> bool:
        """Whether this was logged within the last second, and need not be again; if not, that it is from now on."""
        before = self._last.get(path)
        if before is not None and all(isinstance(one, DRAWN) for one in archetypes):
            then, last = before
            same_timelines = (then.frame is None) == (moment.frame is None)
            if same_timelines and 0 <= moment.capture_ns - then.capture_ns < AGAIN_NS and _equal(last, archetypes):
                return True
        self._last[path] = moment, archetypes
        return False


def _equal(some: Sequence[rr.AsComponents], others: Sequence[rr.AsComponents]) -> bool:
    return some is others or (
        len(some) == len(others) and all(a is b or a == b for a, b in zip(some, others, strict=True))
    )
