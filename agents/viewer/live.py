"""The live viewer: whatever the dataflow brings, as a Rerun file, and on the screen if there is one.

    put ─▶ backlog ─▶ one thread decodes, maps and writes the file ─▶ backlog ─▶ one thread feeds the screen

Neither backlog makes anyone wait. Logging to a viewer that is frozen blocks for as long as it is frozen, so only the
last thread ever talks to one, and the file goes on. What had to be let go is counted, shown in the recording and
reported; none of it is lost, because the source of truth is the recorder's file.
"""

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from agents.viewer.layout import DEFAULT, Scene, live_layout
from agents.viewer.screen import Backlog, Screen
from agents.viewer.showing import Showing
from agents.viewer.sinks import PART_BYTES, Sink, ViewerError, file_sink
from schemas.topics import Delivery
from shared.clock import monotonic_s, now_ns, thread_s
from shared.runtime.taps import Tapped

__all__ = ["LiveViewer", "ViewerError", "ViewerReport"]

ROOM_LATEST = 30
ROOM_LOSSLESS = 2000
"""Messages of one key that may wait to be shown."""

DRAIN_S = 10.0

_log = logging.getLogger("suturegrasp.viewer")


@dataclass(frozen=True)
class ViewerReport:
    """What was shown, by topic, and what was not.

    Fields:
        path: of the file, None where there is none.
        shown: messages that are in the view.
        dropped: there was no room for them; what did not reach the screen counts under `screen`.
        thinned: left out on purpose, because their topic is faster than it is shown.
        unreadable: messages that are none, or hold images that are none.
        notes: what is to be said about the viewer itself.
    """

    path: Path | None
    shown: dict[str, int]
    dropped: dict[str, int]
    thinned: dict[str, int]
    unreadable: dict[str, int]
    notes: tuple[str, ...]


def report_of(path: Path | None, showing: Showing, dropped: dict[str, int], notes: tuple[str, ...]) -> ViewerReport:
    """What became of all that was to be shown."""
    return ViewerReport(path, dict(showing.shown), dropped, dict(showing.thinned), dict(showing.unreadable), notes)


class LiveViewer:
    """Shows what is put into it until it is closed."""

    def __init__(self, rrd_path: Path | None, show: str, session_id: str, layout_name: str = DEFAULT) -> None:
        """Begin a file, where a path is given, and open a viewer: `file` opens none, `native` a window, `web` a page.

        Where no viewer can be opened, the notes say so, and the file is written all the same.

        Raises:
            ViewerError: where the file cannot be written.
        """
        layout = live_layout(layout_name, Scene())
        self._path = rrd_path
        self._file = None if rrd_path is None else file_sink(rrd_path, session_id, layout, PART_BYTES)
        self._notes: list[str] = []
        self._screen: Screen | None = None
        self._showing = Showing(self._to_sinks, layout_name)
        self._backlog: Backlog[tuple[Tapped, int]] = Backlog()
        if show != "file":
            try:
                self._screen = Screen(session_id, layout)
                self._note(self._screen.open(show))
            except ViewerError as error:
                self._note(str(error))
        self._thread = threading.Thread(target=self._show_all, name="viewer", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Where Rerun viewers can connect to, empty where nothing is served."""
        return self._screen.address if self._screen else ""

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be said about the viewer itself, such as where its page is, or why there is none."""
        return tuple(self._notes)

    def put(self, tapped: Tapped) -> None:
        """Have a message shown; never waits."""
        room = ROOM_LATEST if tapped.topic.delivery is Delivery.LATEST else ROOM_LOSSLESS
        self._backlog.put(tapped.key, (tapped, now_ns()), room, str(tapped.topic))

    def close(self) -> ViewerReport:
        """Show what waits, end the file, and say what was shown. A window stays open."""
        self._backlog.close()
        self._thread.join(DRAIN_S)
        if self._thread.is_alive():
            self._backlog.abandon()
            self._note(f"the end is not shown: writing it takes longer than {DRAIN_S:.0f} s")
        if self._screen:
            self._screen.close()
        return report_of(self._path, self._showing, self._dropped(), self.notes)

    def _show_all(self) -> None:
        room = MachineLoad()
        while (taken := self._backlog.take()) is not None:
            worked_s, took_s = thread_s(), monotonic_s()
            self._showing.show(*taken)
            self._showing.count(self._dropped())
            if room.worked(thread_s() - worked_s, monotonic_s() - took_s):
                self._showing.give_room(room.there_is)
        self._showing.count(self._dropped(), at_least_every_ns=0)
        if self._file:
            self._file.close()

    def _dropped(self) -> dict[str, int]:
        return self._backlog.dropped() | (self._screen.dropped() if self._screen else {})

    def _to_sinks(self, action: Callable[[Sink], None]) -> None:
        if self._file:
            action(self._file)
        if self._screen:
            self._screen.put(action)

    def _note(self, text: str) -> None:
        self._notes.append(text)
        _log.warning(text)


JUDGED_EVERY_S = 1.0
"""Of the clock, in which the thread had work."""
FULL, ROOMY = 0.6, 0.85
"""Shares of that time that it had a processor: below the one the machine is full, above the other one it has room."""


class MachineLoad:
    """Whether a machine has room for whoever only looks on, by how long a thread waits for a processor while it works.

    Judges anew after every second of work; before the first one, there is room.
    """

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
