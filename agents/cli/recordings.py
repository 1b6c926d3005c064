"""One recording after another: where the disk is full, the next one begins once it has room again."""

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from agents.cli.session_folder import free_path
from agents.recorder.disk import DiskGuard
from agents.recorder.recorder import Recorder, RecordingReport
from schemas.topics import Topic
from shared.recording.entry import Note
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

LOOK_S = 0.1


class Recordings:
    """Records what a connection hears until told to stop.

    Subscribers get the events of the time before too, so a recording that begins anew lacks none. What the recorder
    itself tells the rig is not recorded, for it lies in the recording's notes and losses.

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
        while True:
            connection.listen(topics, self._put_into(self._recorder), self._recorder.missed)
            while not stopped.is_set() and not self._recorder.ended.wait(LOOK_S):
                pass
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

    def _put_into(self, recorder: Recorder) -> Callable[[Tapped], None]:
        def put(tapped: Tapped) -> None:
            if not tapped.key.startswith(self._own):
                recorder.put(tapped)

        return put

    def _begun_again(self, stopped: threading.Event) -> bool:
        """Wait for room and begin the next recording; False where told to stop before."""
        while not stopped.wait(LOOK_S):
            if not self._guard.has_room_again():
                continue
            path = free_path(self._path)
            try:
                self._recorder = self._make(path)
            except OSError:
                continue
            self._path = path
            return True
        return False
