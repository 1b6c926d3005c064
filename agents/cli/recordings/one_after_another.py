"""One recording after another: where the disk is full, the next one begins once it has room again."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

from agents.launch.session_folder import free_path
from agents.recorder.intake import DiskGuard
from agents.recorder.recorder import Recorder, RecordingReport
from schemas.topics import Delivery, Topic
from shared.recording.entry import Note
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

LOOK_S = 0.1
EVENTS_HELD = 3000
"""Of all publishers, some minutes of a busy rig; fewer than may wait for a recording's first write."""


class Recordings:
    """Records what a connection hears until told to stop.

    The newest events and states stay in memory, and a recording that begins anew begins with them, so that it has those
    of the meantime, and those that the full disk could not take. What the recorder itself tells the rig is left out:
    it lies in the recording's notes and losses.

    Fields:
        fault: why nothing is recorded at the moment; empty while it is.
        reports: of the recordings that have ended.
    """

    def __init__(
        self, first: Path, make: Callable[[Path], Recorder], guard: DiskGuard, log: logging.Logger, own: str
    ) -> None:
        """Begin the first recording; `own` is what the recorder's own keys begin with.

        Raises:
            OSError: where it cannot be written.
        """
        self._path, self._make, self._guard, self._log, self._own = first, make, guard, log, own
        self._recorder = make(first)
        self._lock = threading.Lock()
        self._events, self._states = deque[Tapped](maxlen=EVENTS_HELD), dict[str, Tapped]()
        self.fault, self.reports = "", list[RecordingReport]()

    def note(self, note: Note) -> None:
        """Have facts written into the recording of the moment."""
        self._recorder.note(note)

    def trigger(self, reason: str) -> None:
        """Have the moment marked in it."""
        self._recorder.trigger(reason)

    def run(
        self,
        connection: Connection,
        topics: tuple[Topic, ...],
        stopped: threading.Event,
        ended: Callable[[RecordingReport], None],
    ) -> None:
        """Record until stopped; `ended` is told of each recording at its end."""
        connection.listen(topics, self._put, self._missed)
        while True:
            while not stopped.is_set() and not self._recorder.ended.wait(LOOK_S):
                pass
            if stopped.is_set():
                connection.close()
            report = self.close(ended)
            if not report.fault:
                return
            self.fault = report.fault
            self._log.error(report.fault)
            if not self._begun_again(stopped):
                return
            self.fault = ""
            self._log.warning("recording goes on in %s", self._path)

    def close(self, ended: Callable[[RecordingReport], None]) -> RecordingReport:
        """End the recording of the moment."""
        report = self._recorder.close()
        self.reports.append(report)
        ended(report)
        return report

    def _put(self, tapped: Tapped) -> None:
        if tapped.key.startswith(self._own):
            return
        with self._lock:
            if tapped.topic.delivery is Delivery.EVENT:
                self._events.append(tapped)
            elif tapped.topic.delivery is Delivery.STATE:
                self._states[tapped.key] = tapped
            self._recorder.put(tapped)

    def _missed(self, topic: Topic, count: int) -> None:
        self._recorder.missed(topic, count)

    def _begun_again(self, stopped: threading.Event) -> bool:
        """Wait for room and begin the next recording; False where told to stop before."""
        while not stopped.wait(LOOK_S):
            if not self._guard.has_room_again():
                continue
            path = free_path(self._path)
            try:
                recorder = self._make(path)
            except OSError:
                continue
            with self._lock:
                for tapped in (*self._states.values(), *self._events):
                    recorder.put(tapped)
                self._recorder, self._path = recorder, path
            return True
        return False
