"""Whether somebody stands by, by challenge and answer: who acts asks, by its own clock.

The bridge's challenge is the time at which it issued it, told with its state. An answer echoes it, so it is as young as
the challenge: what a queue held back for three seconds tells that somebody was there three seconds ago. No clock but
the bridge's own counts, which does not jump while an arm is armed (shared/runtime/clocks.py).
"""

from collections import deque

KEPT_NS = 10_000_000_000
"""An answer that comes later than that is told to be older than this."""


class Challenges:
    """What one bridge has issued."""

    def __init__(self) -> None:
        self._issued: deque[int] = deque()

    def issue(self, now_ns: int) -> int:
        """The next challenge. Where the clock was set back, nothing of before counts any more."""
        if self._issued and now_ns <= self._issued[-1]:
            self._issued.clear()
        self._issued.append(now_ns)
        while now_ns - self._issued[0] > KEPT_NS:
            self._issued.popleft()
        return now_ns

    def age_ns(self, challenge_ns: int, now_ns: int) -> int | None:
        """How long ago it was issued; None for what never was, or too long ago to be known."""
        return now_ns - challenge_ns if challenge_ns in self._issued else None

    def behind_ns(self, challenge_ns: int, now_ns: int) -> int | None:
        """For how long a newer one has been out: how far its sender is behind, however seldom challenges are issued.

        0 for the newest, None as for `age_ns`.
        """
        if challenge_ns not in self._issued:
            return None
        newer = next((issued_ns for issued_ns in self._issued if issued_ns > challenge_ns), now_ns)
        return now_ns - newer
