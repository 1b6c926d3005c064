"""Which set points of a bridge that is elsewhere may go on to the console.

A link that stands still for a while lets what it kept go on at once when it is back, and a console executes whatever
comes. So set points carry their sender's time, and one that is older than FRESH_NS goes no further. How long the link
takes at its best is learnt from what the bridge sends all the time, moving or not; until LEARNT_NS after the first of
that, nothing passes, since it may itself have been kept. What a link has kept for less than FRESH_NS is fresh when it
goes on; so once the guard has held the arm, nothing of the same motion passes any more: set points have to pause first.
"""

from shared.ros.far_clock import FarClock

FRESH_NS = 50_000_000
LEARNT_NS = 1_000_000_000
ANEW_NS = 200_000_000
"""Set points that were sent so long after the one before are those of another motion."""


class Gate:
    """One link."""

    def __init__(self) -> None:
        """Nothing is known of it yet."""
        self._clock, self._first_ns, self._newest_ns = FarClock(), 0, 0
        self._shut, self._sent_ns = False, 0

    def alive(self, stamp_ns: int, arrived_ns: int) -> None:
        """Learn from a message of no consequence."""
        self._first_ns = self._first_ns or arrived_ns
        self._clock.measured_ns(stamp_ns, arrived_ns)

    def shut(self) -> None:
        """The arm was held: what follows on the last set point, or comes before it, goes no further."""
        self._shut = True

    def passes(self, stamp_ns: int, arrived_ns: int) -> bool:
        """Whether a set point is fresh, not before one that has passed, and of no motion that was held."""
        self._shut = self._shut and stamp_ns - self._sent_ns < ANEW_NS
        self._sent_ns = max(self._sent_ns, stamp_ns)
        age_ns = arrived_ns - self._clock.measured_ns(stamp_ns, arrived_ns)
        learnt = self._first_ns > 0 and arrived_ns - self._first_ns > LEARNT_NS
        if self._shut or not learnt or age_ns > FRESH_NS or stamp_ns < self._newest_ns:
            return False
        self._newest_ns = stamp_ns
        return True
