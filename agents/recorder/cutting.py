"""A shorter recording out of a longer one: to show a moment to somebody, to keep what matters, to test with it."""

import contextlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from agents.recorder.derived_file import DerivedFile, derived_from
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.topics import FRAMES, OBSERVATIONS, Delivery, is_known, topic_of
from shared.recording.completeness import Completeness, completeness
from shared.recording.derivation import BEFORE_AND_AFTER, UNKNOWN_TOPICS, UNUSED_FRAMES
from shared.recording.entry import Entry, Note, RecordingError
from shared.recording.losses import AT, LOST, counts_of
from shared.recording.mcap_file import UntilDamage, read_attachments


@dataclass(frozen=True)
class CutReport:
    """What a cut holds.

    Fields:
        kept: messages.
        unused: frames that were left out because nothing was made of them.
        source: what the recording that it was cut out of says of itself.
        damage: what broke off the reading of it; empty where all was read.
    """

    kept: int
    unused: int
    source: Completeness
    damage: str


class _Place(NamedTuple):
    key: str
    epoch: int
    sequence: int


def cut(source: Path, target: Path, from_ns: int, to_ns: int, only_used_frames: bool = False) -> CutReport:
    """Write what was received from one moment to another, both included, with the states that held when it began.

    Args:
        only_used_frames: of the camera's frames keep those that perception made observations of.

    Raises:
        RecordingError, OSError: as `read_recording`, or where the target cannot be written.
    """
    used = _used_frames(source, from_ns, to_ns) if only_used_frames else None
    said = completeness(source)
    file = DerivedFile(target)
    stretch = _Stretch(from_ns, to_ns)
    kept = unused = 0
    attached: dict[str, bytes] = {}
    try:
        begun = derived_from(source, said, "cut", left_out={} if used is None else {UNUSED_FRAMES: 0})
        with contextlib.suppress(RecordingError):
            attached = read_attachments(source)
        file.begin(begun, attached)
        for entry in stretch.entries(source, file):
            topic = topic_of(entry.key)
            if used is not None and topic is FRAMES and _place(entry) not in used:
                unused += 1
                continue
            file.write(topic, entry)
            # what is repeated from before the stretch is no message of it
            kept += not entry.repeated
        left_out = {BEFORE_AND_AFTER: stretch.outside, UNKNOWN_TOPICS: stretch.unknown, UNUSED_FRAMES: unused}
        told = replace(begun, how=stretch.sentence, left_out={what: n for what, n in left_out.items() if n})
        if stretch.damage:
            told = replace(told, source_said=stretch.damage)
        file.close(told, False if stretch.damage else said.complete, stretch.lost)
    finally:
        file.abandon()
    return CutReport(kept, unused, said, stretch.damage)


class _Stretch:
    """Reads a stretch of a recording, and counts what lies outside, and what is known to be lost within."""

    def __init__(self, from_ns: int, to_ns: int) -> None:
        self._from_ns, self._to_ns = from_ns, to_ns
        self.outside, self.unknown, self._first_ns = 0, 0, None
        self.lost: Counter[str] = Counter()
        self.damage = ""

    @property
    def sentence(self) -> str:
        """Where it lies in its source."""
        first_ns = self._from_ns if self._first_ns is None else self._first_ns
        begin_s, end_s = ((at_ns - first_ns) * 1e-9 for at_ns in (self._from_ns, self._to_ns))
        return f"cut from {begin_s:.1f} s to {end_s:.1f} s"

    def entries(self, source: Path, file: DerivedFile) -> Iterator[Entry]:
        """The states that held before, then all of the stretch; notes are copied on the way."""
        states: dict[str, Entry] = {}
        begun = False
        records = UntilDamage(source)
        for record in records:
            if isinstance(record, Note):
                self._note(record, file)
                continue
            if self._first_ns is None and not record.repeated:
                self._first_ns = record.at_ns
            if not is_known(record.key):
                self.unknown += 1
                continue
            if not self._from_ns <= record.received_ns <= self._to_ns:
                self.outside += not record.repeated
                if record.received_ns < self._from_ns and topic_of(record.key).delivery is Delivery.STATE:
                    states[record.key] = record
            else:
                if not begun:
                    begun = True
                    yield from (replace(state, repeated=True) for state in states.values())
                yield record
        self.damage = records.damage

    def _note(self, note: Note, file: DerivedFile) -> None:
        if note.name == LOST:
            at_ns = note.facts.get(AT, "")
            if not (at_ns.isdecimal() and self._from_ns <= int(at_ns) <= self._to_ns):
                return
            self.lost.update(counts_of(note))
        file.note(note)


def _used_frames(source: Path, from_ns: int, to_ns: int) -> set[_Place]:
    used: set[_Place] = set()
    for entry in UntilDamage(source):
        if isinstance(entry, Note):
            continue
        if (
            not is_known(entry.key)
            or topic_of(entry.key) is not OBSERVATIONS
            or not from_ns <= entry.received_ns <= to_ns
        ):
            continue
        try:
            consumed = decode(OBSERVATIONS.message, entry.payload).consumed
        except MessageError:
            continue
        used |= {_Place(c.key, c.epoch, c.sequence) for c in consumed}
    return used


def _place(entry: Entry) -> _Place:
    return _Place(entry.key, entry.epoch, entry.sequence)
