"""When something was measured, on this host's clock, from the stamp of a sender whose clock is another.

With stamp s by the sender's clock and arrival a by ours, a - s is the clocks' offset and the delay on the way. That is
never negative, so the least a - s of the last while is the offset and the least delay, and s plus that least is when
the message would have come had nothing held it up: after the measurement by the least delay, a millisecond or so. What
a link kept back for a while so shows its age, however different the clocks are.
"""

WINDOW_NS = 30_000_000_000
"""Clocks drift apart by a millisecond in that time, at 30 ppm."""


class FarClock:
    """The least offset of one to two windows back."""

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._least: list[int] = []
        self._begun_ns = 0

    def measured_ns(self, stamp_ns: int, arrived_ns: int) -> int:
        """When what arrives now with this stamp was measured, on this host's clock; of no stamp (0), now."""
        if stamp_ns == 0:
            return arrived_ns
        offset_ns = arrived_ns - stamp_ns
        if not self._least:
            self._least, self._begun_ns = [offset_ns, offset_ns], arrived_ns
        if arrived_ns - self._begun_ns > WINDOW_NS:
            self._least, self._begun_ns = [self._least[1], offset_ns], arrived_ns
        self._least[1] = min(self._least[1], offset_ns)
        return stamp_ns + min(self._least)

    def forget(self) -> None:
        """The sender's clock was set."""
        self._least = []
