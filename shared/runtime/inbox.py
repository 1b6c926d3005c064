"""What has arrived for an agent and has not been looked at: newest-only slots and lossless queues.

Filling it never waits, so Zenoh's threads are never held up by a slow agent. Events, states and commands are handed out
first and in order; then, of each key of a *latest* topic, the newest message alone. What an agent only remembers waits
aside until the agent acts on something else.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from schemas.messages import CommandAnswer
from schemas.topics import Topic


class Arrival(NamedTuple):
    """A message as it came, not yet decoded.

    Fields:
        payload: gives the bytes; of what is dropped, they are never copied.
        answer: sends the answer of a command; None for anything else.
        named: the key that it names as its own, where it came under another; it is to be refused.
    """

    topic: Topic
    key: str
    payload: Callable[[], bytes]
    attachment: bytes
    answer: Callable[[CommandAnswer], None] | None = None
    named: str = ""


class Inbox:
    """Arrivals between the threads that receive and the loop that steps."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # a bare lock rings in half the time of a condition; it is held, but for the moment of a ring
        self._bell, self._waits = threading.Lock(), False
        self._bell.acquire()
        self._first: deque[Arrival] = deque()
        self._queue: deque[Arrival] = deque()
        self._newest: dict[str, Arrival] = {}
        self._remembered: dict[str, Arrival] = {}
        self._woken = False
        self._dropped: dict[Any, int] = {}

    def put(self, arrival: Arrival) -> None:
        """Add what must not be lost."""
        with self._lock:
            self._queue.append(arrival)
            self._ring()

    def put_first(self, arrival: Arrival, most: int) -> bool:
        """Add what goes before all else; False, and nothing is added, where so many of it wait already."""
        with self._lock:
            if len(self._first) >= most:
                return False
            self._first.append(arrival)
            self._ring()
            return True

    def put_newest(self, arrival: Arrival) -> None:
        """Add what replaces an older arrival of its key that nobody has looked at; that one counts as dropped."""
        with self._lock:
            if self._newest.pop(arrival.key, None) is not None:
                self._dropped[str(arrival.topic)] = self._dropped.get(str(arrival.topic), 0) + 1
            self._newest[arrival.key] = arrival
            self._ring()

    def remember(self, arrival: Arrival) -> None:
        """Keep what nobody acts on, in place of an older arrival of its key; no `take` wakes up for it."""
        with self._lock:
            self._remembered[arrival.key] = arrival

    def remembered(self) -> list[Arrival]:
        """What was to be remembered since the last call, the newest of each key."""
        if not self._remembered:
            return []
        with self._lock:
            kept, self._remembered = self._remembered, {}
        return list(kept.values())

    def take(self, timeout_s: float) -> Arrival | None:
        """The next arrival; None where none came in time, or where somebody called `wake`. One thread takes."""
        with self._lock:
            if self._first or self._queue or self._newest or self._woken:
                return self._next()
            self._waits = True
        self._bell.acquire(timeout=timeout_s)
        with self._lock:
            if not self._waits:
                # rung, if only just after it was waited for
                self._bell.acquire(blocking=False)
            self._waits = False
            return self._next()

    def wake(self) -> None:
        """Let a waiting `take` return at once."""
        with self._lock:
            self._woken = True
            self._ring()

    def _ring(self) -> None:
        if self._waits:
            self._waits = False
            self._bell.release()

    def _next(self) -> Arrival | None:
        if self._first:
            return self._first.popleft()
        if self._woken:
            self._woken = False
            return None
        if self._queue:
            return self._queue.popleft()
        if self._newest:
            return self._newest.pop(next(iter(self._newest)))
        return None

    def dropped(self, topic: Topic) -> int:
        """How many arrivals of a topic were replaced before anybody looked at them."""
        with self._lock:
            return self._dropped.get(str(topic), 0)
