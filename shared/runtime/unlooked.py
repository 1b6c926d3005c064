"""Samples of an input that is only remembered: they wait as they came, until somebody wants to know of them.

A thread that wakes for each of them finds nothing of what it needs in the processor's caches: to look at one alone took
ten times as long as at each of many together.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from shared.clock import monotonic_s

MOST = 48
"""Samples and marks; what waits holds on to memory that is shared with its publisher."""


class Unlooked:
    """What waits between the thread that receives and whoever looks."""

    def __init__(
        self, look_at: Callable[[Any, float], None], emptied: Callable[[], None], at_once: Callable[[], bool]
    ) -> None:
        """`look_at` is given a sample, and when it came; `emptied` is called where the ring was seen empty between.

        `at_once` tells whether they may not wait at the moment.
        """
        self._look_at, self._emptied, self._at_once = look_at, emptied, at_once
        self._waiting: deque[tuple[Any, float]] = deque()
        self._looking = threading.Lock()

    def put(self, sample: Any) -> None:
        """Have a sample wait; None where the ring was seen empty."""
        self._waiting.append((sample, monotonic_s()))
        if len(self._waiting) >= MOST or self._at_once():
            self.look()

    def look(self) -> None:
        """Look at all that waits; any thread may."""
        if not self._waiting:
            return
        with self._looking:
            while self._waiting:
                sample, came_s = self._waiting.popleft()
                if sample is None:
                    self._emptied()
                else:
                    self._look_at(sample, came_s)
