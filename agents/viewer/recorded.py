"""A recording on the screen or as a Rerun file: by the same mapping as live, as fast as it goes, with nothing dropped.

    entries ─▶ one thread decodes, maps, writes the file and feeds the window

Whoever feeds it waits for it. A window that is frozen holds up only that thread, and gives way when the viewer is
closed.
"""

import contextlib
import math
import subprocess
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from agents.viewer.layout import Scene, live_layout
from agents.viewer.live import ViewerReport, report_of
from agents.viewer.showing import Showing
from agents.viewer.sinks import Layout, Sink, ViewerError, file_sink, open_page, served_sink, window_sink
from schemas.topics import FRAMES, known_topic
from shared.recording.mcap_file import Entry
from shared.runtime.attachment import Attachment
from shared.runtime.taps import Tapped

PAGE_MEMORY = "4GiB"
"""What is kept for a page that is opened later."""

STOP_S = 3.0
UNKNOWN_MS = math.nan
"""How long steps took is in no recording."""

__all__ = ["RecordedViewer", "ViewerError"]


class RecordedViewer:
    """Shows the entries of a recording, from a thread of its own, until they end or it is closed.

    Fields:
        showed: payload bytes of the entries so far.
        at_ns: when the last one of them was received; None before the first.
        first_picture: set once an image was logged.
        finished: set once all is shown, written and handed over, or something went wrong.
        error: what ended it early; None where nothing did.
        unknown: messages of keys that the table of topics does not have, by key.
    """

    def __init__(
        self, rrd_path: Path | None, show: str, session_id: str, layout: str, thin: bool, told: Sequence[str] = ()
    ) -> None:
        """Open the window (`native`) or the page (`web`) before anything else, so that it fills while entries come.

        `told` are sentences about the recording, which stand first among all that was said.

        Raises:
            ViewerError: where the file cannot be written, or there is no screen and no file either.
        """
        self.showed, self.at_ns = 0, None
        self.first_picture, self.finished = threading.Event(), threading.Event()
        self.error: Exception | None = None
        self.unknown: Counter[str] = Counter()
        self._path, self._stopped = rrd_path, threading.Event()
        self._sinks: list[Sink] = []
        self._window: subprocess.Popen[bytes] | None = None
        self._page: Sink | None = None
        self._killed = False
        self.notes: list[str] = []
        blueprint = live_layout(layout, Scene())
        if rrd_path is not None:
            self._sinks.append(file_sink(rrd_path, session_id, blueprint))
        if show != "file":
            try:
                self._open(show, session_id, blueprint)
            except ViewerError as error:
                if rrd_path is None:
                    raise
                self.notes.append(str(error))
        self._showing = Showing(self._to_sinks, layout, thin, told)

    def _open(self, show: str, session_id: str, blueprint: Layout) -> None:
        if show == "web":
            sink, address = served_sink(session_id, blueprint, PAGE_MEMORY)
            self._page = sink
            self.notes.append(f"the viewer's page is {open_page(address)}")
        else:
            sink, self._window, address = window_sink(session_id, blueprint)
            self.notes.append(f"a viewer's window is open and fills: {address}")
        self._sinks.append(sink)

    @property
    def served(self) -> bool:
        """Whether a page is served from here, so that it ends when this does."""
        return self._page is not None

    @property
    def window_closed(self) -> bool:
        """Whether a window was opened, and someone has closed it."""
        return self._window is not None and self._window.poll() is not None

    @property
    def window_failed(self) -> bool:
        """Whether the window ended with an error, as where there are no graphics."""
        return self._window is not None and self._window.poll() not in (None, 0) and not self._killed

    def show(self, entries: Iterator[Entry]) -> None:
        """Begin to show entries, in their order."""
        threading.Thread(target=self._show_all, args=(entries,), name="viewer", daemon=True).start()

    def close(self) -> ViewerReport:
        """Stop where it has come to, end the file, and say what was shown. A window stays open, unless it is frozen."""
        self._stopped.set()
        if not self.finished.wait(STOP_S) and self._window is not None:
            self._killed = True
            self._window.kill()
            self._window.wait()
            self.finished.wait(STOP_S)
        if self._page is not None:
            self._page.close()
        return report_of(self._path, self._showing, {}, tuple(self.notes))

    def _show_all(self, entries: Iterator[Entry]) -> None:
        try:
            for entry in entries:
                if self._stopped.is_set():
                    break
                self._show(entry)
            self._showing.count({}, at_least_every_ns=0)
        except Exception as error:
            self.error = error
        finally:
            with contextlib.suppress(Exception):
                for sink in self._sinks:
                    if sink is not self._page:
                        sink.close()
            self.finished.set()

    def _show(self, entry: Entry) -> None:
        self.showed, self.at_ns = self.showed + len(entry.payload), entry.received_ns
        tapped = tapped_of(entry)
        if tapped is None:
            self.unknown[entry.key] += 1
            return
        self._showing.show(tapped, entry.received_ns, counted=not entry.repeated)
        self._showing.count({})
        if tapped.topic == FRAMES and self._showing.shown[str(FRAMES)]:
            self.first_picture.set()

    def _to_sinks(self, action: Callable[[Sink], None]) -> None:
        for sink in self._sinks:
            action(sink)


def tapped_of(entry: Entry) -> Tapped | None:
    """A recorded message as it travelled; None where the table of topics does not have its key."""
    topic = known_topic(entry.key)
    if topic is None:
        return None
    beside = Attachment(entry.epoch, entry.sequence, entry.published_ns, UNKNOWN_MS)
    return Tapped(topic, entry.key, entry.payload, beside)
