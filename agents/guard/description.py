"""What the monitor is told when it starts: the robot by its limits, as one JSON document that names no topic."""

import math
from typing import Any, NamedTuple


class Axis(NamedTuple):
    """A joint, or the jaw: where it may be, and how fast it may go, in its own unit (rad, or m) and seconds."""

    lower: float
    upper: float
    speed: float


class Description(NamedTuple):
    """One arm, as the rig calls it: its joints in their order, then the jaw; the rate (Hz) at which a bridge sends set
    points; whether the console's operator-present pedal counts."""

    arm: str
    axes: tuple[Axis, ...]
    rate_hz: float
    pedal: bool = False

    @staticmethod
    def from_document(document: dict[str, Any]) -> "Description":
        """The description in a JSON document; ValueError where it lacks something, or holds what no arm has."""
        try:
            axes, rate_hz = tuple(Axis(*map(float, axis)) for axis in document["axes"]), float(document["rate_hz"])
            found = Description(str(document["arm"]), axes, rate_hz, bool(document["pedal"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"the guard's description is not complete: {error!r}") from None
        possible = all(axis.lower < axis.upper and 0 < axis.speed < math.inf for axis in axes)
        if len(axes) < 2 or not possible or not 20 <= rate_hz <= 1000:
            raise ValueError("the guard's description holds axes or a rate that no arm has")
        return found
