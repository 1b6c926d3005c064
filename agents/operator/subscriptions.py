"""What the page's server hears of the dataflow: the newest of each topic, decoded when it is wanted.

Zenoh's threads only put things away; of a burst the last is kept. Events are kept in order. What is shown alone, thirty
times a second, is listened to while a page is there: for nobody it would be all that the server does.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.topics import (
    CALIBRATION,
    CHECK,
    EXECUTION,
    FRAMES,
    JUDGEMENT,
    LOG,
    OBSERVATIONS,
    PLAN,
    ROBOT_STATE,
    SURFACE,
    THREAD,
    TOOL,
    Topic,
)
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

NEWEST = (CALIBRATION, ROBOT_STATE, TOOL)
SHOWN = (FRAMES, OBSERVATIONS, SURFACE, THREAD)
EVENTS = (PLAN, EXECUTION, JUDGEMENT, CHECK, LOG)
WAKING = (FRAMES, CALIBRATION, ROBOT_STATE, *EVENTS)
EVENTS_KEPT = 500


class Subscriptions:
    """Everything that came, until it is taken."""

    def __init__(self, connection: Connection, wake: Callable[[Topic], None]) -> None:
        """`wake` is called from other threads for whatever is to be looked at at once."""
        self._connection, self._wake, self._lock = connection, wake, threading.Lock()
        self._shown, self._attending, self._wanted = contextlib.ExitStack(), threading.Lock(), False
        self._newest: dict[str, Tapped] = {}
        self._taken: dict[str, Tapped] = {}
        self._events: deque[Tapped] = deque(maxlen=EVENTS_KEPT)
        connection.listen((*NEWEST, *EVENTS), self._take)

    def attend(self) -> None:
        """Listen to what is shown, from now on."""
        with self._attending:
            if not self._wanted:
                self._wanted = True
                self._shown.enter_context(self._connection.listening(SHOWN, self._take))

    def rest(self, unless: Callable[[], bool]) -> None:
        """Listen to it no more, which takes a moment, and forget it, since it grows old; `unless` is asked last."""
        with self._attending:
            if not self._wanted or unless():
                return
            self._wanted = False
            self._shown.close()
            with self._lock:
                self._newest = {key: tapped for key, tapped in self._newest.items() if tapped.topic not in SHOWN}

    def _take(self, tapped: Tapped) -> None:
        with self._lock:
            if tapped.topic in EVENTS:
                self._events.append(tapped)
            else:
                self._newest[tapped.key] = tapped
        if tapped.topic in WAKING:
            self._wake(tapped.topic)

    def newest(self, topic: Topic) -> list[Any]:
        """The newest message of each key of a topic that has not been taken before."""
        with self._lock:
            fresh = [
                tapped
                for key, tapped in self._newest.items()
                if tapped.topic is topic and self._taken.get(key) is not tapped
            ]
            self._taken |= {tapped.key: tapped for tapped in fresh}
        return [message for tapped in fresh if (message := _decoded(tapped)) is not None]

    def events(self) -> list[tuple[Topic, Any]]:
        """The events that have come since the last call, in order."""
        with self._lock:
            taken = list(self._events)
            self._events.clear()
        return [(tapped.topic, message) for tapped in taken if (message := _decoded(tapped)) is not None]


def _decoded(tapped: Tapped) -> Any | None:
    with contextlib.suppress(MessageError):
        return decode(tapped.topic.message, tapped.payload)
    return None
