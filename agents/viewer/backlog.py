"""What waits to be shown: a bounded queue that never makes anyone wait, and counts what it had to let go.

Every lane has room of its own, so that a flood on one cannot push out what another one brought; what is taken is the
oldest of all lanes.
"""

import threading
from collections import Counter, deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Backlog(Generic[T]):
    """Items between threads, by lane, the oldest of a full lane giving way to the newest."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._lanes: dict[str, deque[tuple[int, T]]] = {}
        self._dropped: Counter[str] = Counter()
        self._tickets = 0
        self._closed = False

    def put(self, lane: str, item: T, room: int, counted_as: str) -> None:
        """Add an item to a lane with that much room; never waits. After `close` it counts as dropped."""
        with self._changed:
            waiting = self._lanes.setdefault(lane, deque())
            if self._closed or len(waiting) >= room:
                self._dropped[counted_as] += 1
                if self._closed:
                    return
                waiting.popleft()
            waiting.append((self._tickets, item))
            self._tickets += 1
            self._changed.notify()

    def take(self) -> T | None:
        """The oldest item, waiting for one; None once the backlog is closed and empty."""
        with self._changed:
            while not (filled := [lane for lane in self._lanes.values() if lane]):
                if self._closed:
                    return None
                self._changed.wait()
            return min(filled, key=lambda lane: lane[0][0]).popleft()[1]

    def close(self) -> None:
        """Take nothing more in; what waits can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def abandon(self) -> None:
        """Let go of what waits, uncounted."""
        with self._changed:
            self._closed = True
            self._lanes.clear()
            self._changed.notify_all()

    def dropped(self) -> dict[str, int]:
        """How many items gave way, by what they count as."""
        with self._changed:
            return dict(self._dropped)
