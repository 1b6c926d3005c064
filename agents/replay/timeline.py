"""Which moment of a recording it is now, and when another one is due.

The recording's time t goes on at a rate r with this machine's s: t = t0 + r (s − s0). While held, r is 0.
"""

import threading


class Timeline:
    """The recording's time, in nanoseconds, by seconds of a clock that never jumps; any thread may ask."""

    def __init__(self, rate: float) -> None:
        """Stand at no moment yet; `rate` holds while not held, and is 0 where only jumps pass time."""
        self._lock = threading.Lock()
        self._rate, self._at_ns, self._since_s = rate, 0, 0.0
        self._held = True

    def jump(self, at_ns: int, now_s: float) -> None:
        """It is that moment now."""
        with self._lock:
            self._at_ns, self._since_s = at_ns, now_s

    def hold(self, now_s: float) -> bool:
        """Let no time pass; whether it did before."""
        with self._lock:
            if self._held:
                return False
            self._at_ns, self._since_s, self._held = self._moment(now_s), now_s, True
            return True

    def go_on(self, now_s: float) -> bool:
        """Let time pass from here; whether it was held before."""
        with self._lock:
            if not self._held:
                return False
            self._since_s, self._held = now_s, False
            return True

    def now(self, now_s: float) -> tuple[int, float]:
        """Which moment it is, and at which rate it goes on."""
        with self._lock:
            return self._moment(now_s), 0.0 if self._held else self._rate

    def due_s(self, at_ns: int) -> float:
        """When a moment comes, if time is not held until then; rates above 0 only."""
        with self._lock:
            return self._since_s + (at_ns - self._at_ns) * 1e-9 / self._rate

    def _moment(self, now_s: float) -> int:
        gone_s = 0.0 if self._held else max(0.0, now_s - self._since_s)
        return self._at_ns + round(gone_s * self._rate * 1e9)
