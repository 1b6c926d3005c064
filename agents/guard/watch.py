"""When an arm must be held by somebody else than its bridge: one decision a turn, from when what was heard last.

The console holds the last set point for ever, so an arm whose bridge is gone stands still by itself. A hold makes that
sure, tells it to everybody, and stops what a bridge sends on that nobody stands by any more.
"""

import enum
from dataclasses import dataclass

FLOW_NS = 100_000_000
"""Set points that came so recently still flow."""
NOBODY_NS = 230_000_000
"""So long after a heartbeat nobody stands by: a little more than the bridge's own 0.2 s, which comes first."""
OBEYS_NS = 100_000_000
"""So long after a hold no set point may come."""

GRACE_NS = 100_000_000
"""The first heartbeat may come to the guard after the set points that it allowed."""


class Action(enum.Enum):
    """What to send to the console."""

    HOLD = "hold"
    PAUSE = "pause"


@dataclass(frozen=True)
class Heard:
    """When each was heard last.

    Fields:
        set_point_ns: that the console gets too, for the arm or its jaw; 0 for never, as below.
        heartbeat_ns: of an operator who stands by this arm.
        over_ns: that the motion is over: the bridge says that it ended as it should, or somebody has sent a hold.
        stranger_ns: a set point that is neither the bridge's nor passed on by the guard.
    """

    set_point_ns: int = 0
    heartbeat_ns: int = 0
    over_ns: int = 0
    stranger_ns: int = 0


class Watch:
    """One arm."""

    def __init__(self) -> None:
        """Nothing has moved yet."""
        self._armed, self._held_ns, self._paused = False, 0, False
        self._flows_from_ns: int | None = None

    def turn(self, heard: Heard, now_ns: int) -> tuple[Action, str] | None:
        """What to send now, and why; each hold once, until set points flow again that somebody stands by."""
        flows = now_ns - heard.set_point_ns < FLOW_NS
        stands_by = now_ns - heard.heartbeat_ns < NOBODY_NS
        self._flows_from_ns = (self._flows_from_ns or now_ns) if flows else None
        if self._held_ns and flows and heard.set_point_ns - self._held_ns > OBEYS_NS and not stands_by:
            return self._pause()
        if flows and stands_by:
            self._armed, self._held_ns, self._paused = True, 0, False
        if self._held_ns:
            return None
        if self._flows_from_ns and not stands_by and now_ns - self._flows_from_ns > GRACE_NS:
            return self._hold(now_ns, "set points come and nobody stands by")
        if self._armed and now_ns - heard.stranger_ns < FLOW_NS:
            return self._hold(now_ns, "somebody else sends set points too")
        if self._armed and not flows:
            if heard.over_ns < heard.set_point_ns:
                return self._hold(now_ns, "set points have ended, and not as a motion should")
            self._armed = False
        return None

    def _hold(self, now_ns: int, why: str) -> tuple[Action, str]:
        self._armed, self._held_ns = False, now_ns
        return Action.HOLD, why

    def _pause(self) -> tuple[Action, str] | None:
        if self._paused:
            return None
        self._paused = True
        return Action.PAUSE, "set points come although the arm was held"
