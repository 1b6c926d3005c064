"""The recorder: a thread writes what others put into a queue, so that neither waits for the disk."""

import queue
import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from shared.recording.mcap_file import Entry, RecordingWriter
from schemas.topics import Topic, topic_of
from shared.clock import monotonic_s, now_ns
from shared.runtime.taps import KeyLosses, Tapped

QUEUE_LIMIT = 4000
"""Messages that may wait for the disk, some seconds of everything; beyond that they are lost, and counted."""
FLUSH_S = 0.5
"""What a killed recorder loses at most."""
LOOK_S = 0.1
LOSSES = "losses"
"""The note at the end of a recording: how many messages it lacks, by key."""


@dataclass(frozen=True)
class RecordingReport:
    """What a recording holds, and what it lacks, by key.

    Fields:
        lost: never came, found no room in the queue, or could not be written; by topic where no key is known.
        unnumbered: came without a sequence number, and are not recorded.
        fault: why nothing more could be written; empty where all is well.
    """

    path: Path
    received: dict[str, int]
    lost: dict[str, int]
    unnumbered: int
    fault: str = ""

    @property
    def complete(self) -> bool:
        """Whether nothing is known to be missing."""
        return not self.lost and self.unnumbered == 0 and not self.fault


class Recorder:
    """Records until it is closed, which leaving its `with` block does. One that is never closed keeps no process alive.

    Raises:
        OSError: where the file cannot be written.
    """

    def __init__(self, path: Path, queue_limit: int = QUEUE_LIMIT) -> None:
        self._path, self._writer = path, RecordingWriter(path)
        self._queue: queue.Queue[tuple[Tapped, int]] = queue.Queue(queue_limit)
        self._lock = threading.Lock()
        self._gaps: defaultdict[str, KeyLosses] = defaultdict(KeyLosses)
        self._unwritten: defaultdict[str, int] = defaultdict(int)
        self._missed: defaultdict[str, int] = defaultdict(int)
        self._unnumbered, self._fault = 0, ""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def put(self, tapped: Tapped) -> None:
        """Queue a message; never waits."""
        with self._lock:
            if self._closing.is_set():
                return
            if tapped.beside is None:
                self._unnumbered += 1
                return
            self._gaps[tapped.key].count(tapped.beside)
            try:
                # the time is read under the lock, so that the file is in the order of its times
                self._queue.put_nowait((tapped, now_ns()))
            except queue.Full:
                self._unwritten[tapped.key] += 1

    def missed(self, topic: Topic, count: int) -> None:
        """Count messages that Zenoh reports as lost."""
        with self._lock:
            self._missed[str(topic)] += count

    def close(self) -> RecordingReport:
        """Write what is queued, the losses, and the summary; what comes later is not recorded."""
        if self._closing.is_set():
            return self.report()
        self._closing.set()
        self._thread.join()
        lost = {key: str(count) for key, count in self.report().lost.items()}
        self._do(lambda: self._writer.note(LOSSES, lost | {"complete": str(self.report().complete)}))
        self._do(self._writer.close)
        self._writer.abandon()
        return self.report()

    def report(self) -> RecordingReport:
        """What was received and lost so far."""
        with self._lock:
            gaps = {key: losses.lost for key, losses in self._gaps.items()}
            seen = {key: losses.received for key, losses in self._gaps.items()}
            unwritten, missed = dict(self._unwritten), dict(self._missed)
            unnumbered, fault = self._unnumbered, self._fault
        lost = {key: gaps[key] + unwritten.get(key, 0) for key in gaps}
        # what Zenoh reports as lost shows as a gap too, unless nothing came after it
        for name, count in missed.items():
            lost[name] = max(0, count - sum(gap for key, gap in gaps.items() if str(topic_of(key)) == name))
        received = {key: count - unwritten.get(key, 0) for key, count in seen.items()}
        return RecordingReport(self._path, received, {k: n for k, n in lost.items() if n}, unnumbered, fault)

    def _write_all(self) -> None:
        next_flush_s = monotonic_s() + FLUSH_S
        while not (self._closing.is_set() and self._queue.empty()):
            try:
                tapped, received_ns = self._queue.get(timeout=LOOK_S)
            except queue.Empty:
                pass
            else:
                self._write(tapped, received_ns)
            if monotonic_s() >= next_flush_s:
                self._do(self._writer.flush)
                next_flush_s = monotonic_s() + FLUSH_S

    def _write(self, tapped: Tapped, received_ns: int) -> None:
        beside = tapped.beside
        if beside is None:
            return
        entry = Entry(tapped.key, beside.epoch, beside.sequence, tapped.payload, beside.published_ns, received_ns)
        # the format holds no time before 1970, and a message that claims one is lost alone
        if entry.published_ns < 0 or not self._do(lambda: self._writer.write(tapped.topic, entry)):
            with self._lock:
                self._unwritten[tapped.key] += 1

    def _do(self, write: Callable[[], None]) -> bool:
        """Write, unless the disk has failed before: the first fault is the cause of those that would follow."""
        if self._fault:
            return False
        try:
            write()
        except OSError as error:
            self._fault = f"{self._path} cannot be written: {error.strerror or error}"
            return False
        return True
