"""Whether a machine has room for whoever only looks on, from how long a thread waits for a processor while it works.

That is told by the thread alone, on any system, and holds whatever else runs there.
"""

JUDGED_EVERY_S = 1.0
"""Of the clock, in which the thread had work."""
FULL, ROOMY = 0.6, 0.85
"""Shares of that time that it had a processor: below the one the machine is full, above the other one it has room."""


class Room:
    """Judges anew after every second of work; before the first one, there is room."""

    def __init__(self) -> None:
        self.there_is = True
        self._worked_s = self._took_s = 0.0

    def worked(self, worked_s: float, took_s: float) -> bool:
        """Note so much time of the processor in so much time of the clock; whether the judgement has changed."""
        self._worked_s, self._took_s = self._worked_s + worked_s, self._took_s + took_s
        if self._took_s < JUDGED_EVERY_S:
            return False
        before, share = self.there_is, self._worked_s / self._took_s
        self.there_is = share > ROOMY or (before and share >= FULL)
        self._worked_s = self._took_s = 0.0
        return self.there_is != before
