"""A viewer on the screen, fed by a thread that it may hold up without holding up anything else."""

import subprocess
import threading
from collections.abc import Callable

import rerun.blueprint as rrb

from agents.viewer.backlog import Backlog
from agents.viewer.sinks import Sink, ViewerError, open_page, open_window, served_sink

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
