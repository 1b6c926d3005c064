"""A viewer on the screen, fed by a thread that it may hold up without holding up anything else.

What waits to be shown makes nobody wait: every lane has room of its own, so that a flood on one cannot push out what
another one brought; what is taken is the oldest of all lanes, and what was let go is counted.
"""

import subprocess
import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import Generic, TypeVar

import rerun.blueprint as rrb

from agents.viewer.sinks import Sink, ViewerError, open_page, open_window, served_sink

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


SCREEN = "screen"
ROOM = 400
"""Lots of entities that may wait, a few seconds of everything."""

DRAIN_S = 2.0


class Screen:
    """A server for Rerun viewers, with a window or a page on it where one can be opened."""

    def __init__(self, session_id: str, layout: rrb.Blueprint) -> None:
        """Begin to serve.

        Raises:
            ViewerError: where nothing can be served.
        """
        self._sink, self.address = served_sink(session_id, layout)
        self._window: subprocess.Popen[bytes] | None = None
        self._backlog: Backlog[Callable[[Sink], None]] = Backlog()
        self._thread = threading.Thread(target=self._feed, name="screen", daemon=True)
        self._thread.start()

    def open(self, show: str) -> str:
        """Open a window (`native`) or a page (`web`); what is to be said of it."""
        try:
            if show == "web":
                return f"the viewer's page is {open_page(self.address)}"
            self._window = open_window(self.address)
        except ViewerError as error:
            return str(error)
        return f"a viewer's window is open; another one can be: rerun {self.address}"

    def put(self, action: Callable[[Sink], None]) -> None:
        """Have something done to the stream; never waits."""
        self._backlog.put(SCREEN, action, ROOM, SCREEN)

    def dropped(self) -> dict[str, int]:
        """How often the screen was too slow for what was to be shown."""
        return self._backlog.dropped()

    def close(self) -> None:
        """Show what waits, and stop serving. A window stays open, unless it is frozen and would keep us from ending."""
        self._backlog.close()
        self._thread.join(DRAIN_S)
        if self._thread.is_alive():
            self._backlog.abandon()
            if self._window is not None:
                self._window.kill()
                self._window.wait()
                self._thread.join(DRAIN_S)

    def _feed(self) -> None:
        while (action := self._backlog.take()) is not None:
            action(self._sink)
        self._sink.close()
