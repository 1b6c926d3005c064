"""The recorder: a thread writes what others put into a queue, so that neither waits for the disk."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue

from agents.recorder.intake import QUEUE_LIMIT, DiskGuard, Intake, Waiting
from agents.recorder.parts import Attached, FileSettings, Head, Parts, Tally
from agents.recorder.pre_trigger import PreTrigger, PreTriggerSettings
from schemas.topics import Topic
from shared.clock import monotonic_s, now_ns
from shared.recording.completeness import ENDED, REASON
from shared.recording.entry import Entry, Note
from shared.recording.losses import LOSSES, NOT_WRITTEN, Loss, by_key, sentence
from shared.recording.writer import TooManyRunsError
from shared.runtime.taps import Tapped

__all__ = ["LOSSES", "Recorder", "RecorderSettings", "RecordingReport"]

FLUSH_S = 0.3
"""A killed recorder loses this, what it gathers, and what it had no time for."""
GATHER_S = 0.05
"""What comes within this time is written at once: waking up for each message takes longer than writing it."""
LINE_S = 1.0
"""Losses get a line at once, and no more than one in this time."""


@dataclass(frozen=True)
class RecorderSettings:
    """How it is recorded.

    Fields:
        keep_free_bytes: of the disk; None for the guard's own rule.
        pre_trigger: None where everything is recorded.
    """

    files: FileSettings = field(default_factory=FileSettings)
    keep_free_bytes: int | None = None
    pre_trigger: PreTriggerSettings | None = None


@dataclass(frozen=True)
class RecordingReport:
    """What a recording holds, and what it lacks, by key.

    Fields:
        path: of the first file, or where it would be.
        paths: of all files.
        lost: never came, found no room in the queue, or could not be written; by topic where no key is known.
        unnumbered: came without a sequence number, and are not recorded.
        fault: why nothing more could be written; empty where all is well.
    """

    path: Path
    paths: tuple[Path, ...]
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

    def __init__(
        self,
        path: Path,
        queue_limit: int = QUEUE_LIMIT,
        settings: RecorderSettings | None = None,
        notes: tuple[Note, ...] = (),
        attached: tuple[Attached, ...] = (),
        tell: Callable[[str], None] = lambda _line: None,
    ) -> None:
        """`tell` is given a line for whatever should be known at once, from the recorder's thread."""
        self._path, self._tell = path, tell
        settings = settings or RecorderSettings()
        self._intake = Intake(queue_limit)
        self._guard = DiskGuard(path.parent, settings.keep_free_bytes)
        self._tally = Tally()
        head = Head({note.name: note for note in notes}, {one.name: one for one in attached})
        self._sink: Parts | PreTrigger = (
            Parts(path, settings.files, head, self._tally)
            if settings.pre_trigger is None
            else PreTrigger(path, settings.pre_trigger, settings.files, head, self._tally, tell)
        )
        self._notes: SimpleQueue[Note] = SimpleQueue()
        self._asked: SimpleQueue[str] = SimpleQueue()
        self._fault, self._untold, self._next_line_s = "", list[Loss](), 0.0
        self.ended = threading.Event()
        """Set when nothing more is recorded, whether it was closed or the disk has no room."""
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def put(self, tapped: Tapped) -> None:
        """Queue a message; never waits."""
        self._intake.put(tapped)

    def missed(self, topic: Topic, count: int) -> None:
        """Count messages that Zenoh reports as lost."""
        self._intake.missed(topic, count)

    def note(self, note: Note) -> None:
        """Have facts about the recording written into it; those of the same name replace them in later files."""
        self._notes.put(note)

    def trigger(self, reason: str) -> None:
        """Have the moment marked; where only events are kept, this is one."""
        self._asked.put(reason)

    def close(self) -> RecordingReport:
        """Write what is queued, the losses, and the summary; what comes later is not recorded."""
        self._intake.close()
        self._thread.join()
        return self.report()

    def report(self) -> RecordingReport:
        """What was received and lost so far."""
        paths, received, lost = tuple(self._tally.paths), dict(self._tally.received), dict(self._tally.lost)
        return RecordingReport(self._path, paths, received, lost, self._intake.unnumbered, self._fault)

    def _write_all(self) -> None:
        next_flush_s = monotonic_s()
        while not (self._intake.closed and self._intake.empty):
            waiting = self._intake.take(GATHER_S)
            if waiting is not None:
                self._write(waiting)
            if monotonic_s() >= next_flush_s:
                self._look_around()
                next_flush_s = monotonic_s() + FLUSH_S
        self._look_around()
        self._finish()
        self.ended.set()

    def _write(self, waiting: Waiting) -> None:
        tapped, beside, received_ns = waiting.tapped, waiting.beside, waiting.received_ns
        entry = Entry(tapped.key, beside.epoch, beside.sequence, tapped.payload, beside.published_ns, received_ns)
        # the format holds no time before 1970, and a message that claims one is lost alone
        if entry.published_ns < 0 or not self._do(lambda: self._sink.write(tapped.topic, entry)):
            loss = Loss(tapped.key, beside.sequence, beside.sequence, NOT_WRITTEN, received_ns)
            if self._do(lambda: self._sink.lose([loss], received_ns)):
                return
            self._tally.lost.update(by_key([loss]))

    def _look_around(self) -> None:
        """Say what was lost, write what others ask for, hand it all to the system, and look at the disk."""
        at_ns, losses = now_ns(), self._intake.take_losses()
        if losses and not self._do(lambda: self._sink.lose(losses, at_ns)):
            self._tally.lost.update(by_key(losses))
        self._tell_of(losses)
        if self._intake.unnumbered:
            self._sink.spoil()
        while not self._notes.empty():
            note = self._notes.get()
            self._do(lambda note=note: self._sink.note(note))
        while not self._asked.empty():
            reason = self._asked.get()
            self._do(lambda reason=reason: self._sink.trigger(reason, at_ns))
        self._do(lambda: self._sink.flush(at_ns))
        if self._fault:
            # nothing more can be written, which must be told, not found out when the session is over
            self._intake.close()
        elif problem := self._guard.problem():
            self._stop(problem)

    def _tell_of(self, losses: list[Loss]) -> None:
        self._untold += losses
        if self._untold and monotonic_s() >= self._next_line_s:
            self._tell(sentence(self._untold))
            self._untold, self._next_line_s = [], monotonic_s() + LINE_S

    def _stop(self, problem: str) -> None:
        """End the file while there is room to end it."""
        self._intake.close()
        self._do(lambda: self._sink.note(Note(ENDED, {REASON: problem})))
        self._do(lambda: self._sink.close(False))
        self._fault = self._fault or f"recording was stopped: {problem}"

    def _finish(self) -> None:
        complete = self._intake.unnumbered == 0
        self._do(lambda: self._sink.close(complete))
        self._sink.abandon()

    def _do(self, write: Callable[[], None]) -> bool:
        """Write, unless the disk has failed before: the first fault is the cause of those that would follow.

        What alone cannot be written is no fault.
        """
        if self._fault:
            return False
        try:
            write()
        except TooManyRunsError:
            return False
        except OSError as error:
            self._fault = f"{self._path} cannot be written: {error.strerror or error}"
            return False
        return True
