"""A recording as files: one, or several where it grows too large or too long. Each opens by itself.

For that, each begins with a `Head`: notes and attachments, and the newest messages of what lasts.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from agents.recorder.foxglove import FoxgloveCopies
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth, StereoCalibration
from schemas.topics import CALIBRATION, EXECUTION, HEALTH, PLAN, ROBOT_STATE, SIMULATOR_STATE, Topic
from shared.calibration.own_file import calibration_text
from shared.calibration.stated import CalibrationError
from shared.recording.entry import Entry, Note
from shared.recording.foxglove_schemas import DESCRIPTORS
from shared.recording.losses import COMPLETE, LOSSES, Loss, as_note, by_key
from shared.recording.writer import RecordingWriter

REPEATED = (CALIBRATION, ROBOT_STATE, SIMULATOR_STATE, PLAN, EXECUTION)
"""Of these the newest message of each key is repeated: without it, what follows cannot be understood."""
CALIBRATION_FILE = "calibration.json"
AGENT = "agent"
"""A note of each agent that is heard of: its host, version and configuration."""


@dataclass(frozen=True)
class Attached:
    """A file that belongs to a recording."""

    name: str
    media_type: str
    data: bytes


@dataclass
class Head:
    """Notes and attachments by what they are about, and the newest messages of what lasts."""

    notes: dict[str, Note] = field(default_factory=dict[str, Note])
    attached: dict[str, Attached] = field(default_factory=dict[str, Attached])
    entries: dict[str, tuple[Topic, Entry]] = field(default_factory=dict[str, tuple[Topic, Entry]])

    def copy(self) -> "Head":
        """One that goes its own way from here."""
        return Head(dict(self.notes), dict(self.attached), dict(self.entries))

    def follow(self, topic: Topic, entry: Entry) -> Note | Attached | None:
        """Remember a message; what it adds to a file that has begun."""
        if topic in REPEATED:
            self.entries[entry.key] = (topic, entry)
        if topic is CALIBRATION:
            return self._attach_calibration(entry)
        if topic is HEALTH and f"{entry.key} {entry.epoch}" not in self.notes:
            return self._note_agent(entry)
        return None

    def _attach_calibration(self, entry: Entry) -> Attached | None:
        try:
            text = calibration_text(decode(StereoCalibration, entry.payload), entry.key)
        except (MessageError, CalibrationError):
            return None
        attached = Attached(CALIBRATION_FILE, "application/json", text.encode())
        self.attached[CALIBRATION_FILE] = attached
        return attached

    def _note_agent(self, entry: Entry) -> Note | None:
        try:
            health = decode(AgentHealth, entry.payload)
        except MessageError:
            return None
        facts = {name: str(getattr(health, name)) for name in ("agent", "instance", "host", "version", "config_hash")}
        note = Note(AGENT, {**facts, "epoch": str(entry.epoch), "key": entry.key})
        self.notes[f"{entry.key} {entry.epoch}"] = note
        return note


PART = "part"
"""The note that numbers the files of a recording."""


@dataclass(frozen=True)
class FileSettings:
    """How files are written.

    Fields:
        split_bytes, split_s: when another file is begun; None for never.
        foxglove: whether they hold copies for other programs.
    """

    split_bytes: int | None = None
    split_s: float | None = None
    foxglove: bool = True


@dataclass
class Tally:
    """What all files of a recorder hold, and lack, by key."""

    paths: list[Path] = field(default_factory=list[Path])
    received: Counter[str] = field(default_factory=Counter[str])
    lost: Counter[str] = field(default_factory=Counter[str])


class Parts:
    """Writes one recording from its head until it is closed.

    Raises:
        OSError: where a file cannot be written.
    """

    def __init__(self, path: Path, settings: FileSettings, head: Head, tally: Tally) -> None:
        self._path, self._settings, self._head, self._tally = path, settings, head, tally
        self._copies = FoxgloveCopies()
        self._number = 0
        self._writer = self._begin()

    def write(self, topic: Topic, entry: Entry) -> None:
        """Add a message, in another file where this one is full."""
        if self._is_full(entry):
            self._finish(True)
            self._writer = self._begin()
        self._began_ns = self._began_ns or entry.received_ns
        self._writer.write(topic, entry)
        self._copy(topic, entry)
        self._tally.received[entry.key] += 1
        added = self._head.follow(topic, entry)
        if isinstance(added, Note):
            self._writer.note(added.name, added.facts)
        elif added is not None:
            self._attach(self._writer, added, entry.received_ns)

    def note(self, note: Note) -> None:
        """Add facts; the files that follow begin with them."""
        self._head.notes[note.name] = note
        self._writer.note(note.name, note.facts)

    def lose(self, losses: Iterable[Loss], at_ns: int) -> None:
        """Say what is lost where it is lost."""
        note = as_note(losses, at_ns)
        self._writer.note(note.name, note.facts)
        counts = by_key(losses)
        self._lost.update(counts)
        self._tally.lost.update(counts)

    def spoil(self) -> None:
        """This file is not complete, whatever it says it lacks."""
        self._whole = False

    def trigger(self, reason: str, at_ns: int) -> None:
        """Mark the moment."""
        self._writer.note("marked", {"reason": reason, "at_ns": str(at_ns)})

    def flush(self, _now_ns: int) -> None:
        """Hand everything so far to the system, so that it outlives this process."""
        self._writer.flush()

    def close(self, complete: bool = True) -> None:
        """Write what is missing, and the summary."""
        self._finish(complete)

    def abandon(self) -> None:
        """Close the file as it is."""
        self._writer.abandon()

    def _begin(self) -> RecordingWriter:
        self._number += 1
        path = self._path if self._number == 1 else self._path.with_stem(f"{self._path.stem}_part{self._number}")
        writer = RecordingWriter(path)
        self._tally.paths.append(path)
        self._lost: Counter[str] = Counter()
        self._whole, self._began_ns = True, 0
        writer.note(PART, {"number": str(self._number), "first": self._path.name})
        for note in self._head.notes.values():
            writer.note(note.name, note.facts)
        remembered = sorted(self._head.entries.values(), key=lambda one: one[1].received_ns)
        for attached in self._head.attached.values():
            self._attach(writer, attached, remembered[0][1].received_ns if remembered else 0)
        self._writer = writer
        for topic, entry in remembered:
            repeated = replace(entry, repeated=True)
            writer.write(topic, repeated)
            self._copy(topic, repeated)
        if self._number > 1:
            writer.flush()
        return writer

    def _is_full(self, entry: Entry) -> bool:
        split_bytes, split_s = self._settings.split_bytes, self._settings.split_s
        if self._began_ns == 0:
            return False
        too_large = split_bytes is not None and self._writer.bytes_written + len(entry.payload) > split_bytes
        return too_large or (split_s is not None and (entry.received_ns - self._began_ns) * 1e-9 >= split_s)

    def _copy(self, topic: Topic, entry: Entry) -> None:
        if self._settings.foxglove:
            for copy in self._copies.of(topic, entry):
                self._writer.write_derived(copy.channel, copy.schema, DESCRIPTORS, copy.payload, entry)

    def _attach(self, writer: RecordingWriter, attached: Attached, at_ns: int) -> None:
        writer.attach(attached.name, attached.media_type, attached.data, at_ns)

    def _finish(self, complete: bool) -> None:
        lost = {key: str(count) for key, count in self._lost.items()}
        # of what nothing was heard of, nobody knows whether there was anything
        known = {COMPLETE: str(complete and self._whole and not lost)} if self._began_ns or lost else {}
        self._writer.note(LOSSES, lost | known)
        self._writer.close()
