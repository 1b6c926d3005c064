"""What the monitor is told when it starts: the robot by its limits, the bounds, and every key as text.

It comes as one JSON document, so that the monitor needs neither the rig's configuration nor the names of topics, and
nothing of it needs NumPy.
"""

import math
from typing import Any, NamedTuple

PRESENCE_NS = 220_000_000
"""Somebody stands by for so long after a challenge was issued that they answered."""
LINK_NS = 100_000_000
"""How old a challenge may be that a set point echoes."""
FRESH_NS = 100_000_000
"""How long ago the arm may have been measured."""
GONE_NS = 100_000_000
"""An open gate through which nothing has passed for so long is shut: a motion sends a set point in each tick."""
GRACE_NS = 100_000_000
"""The first heartbeat may come here so long after the set points that it allowed."""
AHEAD_S, BURST_S = 0.25, 0.06
"""For how long an axis may be ahead of where it is measured, and how much of its travel may come at once, both at its
greatest speed: a PSM follows within 0.02 s, and the ticks of a busy machine come in bursts."""
RATE_MARGIN = 1.5


class Axis(NamedTuple):
    """A joint, or the jaw: where it may be, and how fast it may go, in its own unit (rad, or m) and seconds."""

    lower: float
    upper: float
    speed: float


class Description(NamedTuple):
    """One arm of a robot.

    Fields:
        arm, console: what the rig and what its console call it.
        axes: the joints in their order, then the jaw.
        rate_hz: at which a bridge sends set points.
        pedal: whether the console's operator-present pedal counts.
    """

    arm: str
    console: str
    axes: tuple[Axis, ...]
    rate_hz: float
    pedal: bool = False

    @staticmethod
    def from_document(document: dict[str, Any]) -> "Description":
        """The description in a JSON document.

        Raises:
            ValueError: where it lacks something, or holds what no arm has.
        """
        try:
            axes = tuple(Axis(*(float(value) for value in axis)) for axis in document["axes"])
            found = Description(
                str(document["arm"]),
                str(document["console"]),
                axes,
                float(document["rate_hz"]),
                bool(document["pedal"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"the guard's description is not complete: {error!r}") from None
        possible = all(axis.lower < axis.upper and 0 < axis.speed < math.inf for axis in axes)
        if len(axes) < 2 or not possible or not 0 < found.rate_hz <= 1000:
            raise ValueError("the guard's description holds axes or a rate that no arm has")
        return found
