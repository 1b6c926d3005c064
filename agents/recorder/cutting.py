"""A shorter recording out of a longer one: to show a moment to somebody, to keep what matters, to test with it."""

import mimetypes
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.topics import FRAMES, OBSERVATIONS, Delivery, Topic, topic_of
from shared.recording.completeness import completeness
from shared.recording.entry import Entry, Note
from shared.recording.losses import COMPLETE, LOSSES
from shared.recording.mcap_file import read_attachments, read_recording, read_with_notes
from shared.recording.writer import RecordingWriter

CUT = "cut"
"""The note that says what a file was cut out of."""


@dataclass(frozen=True)
class CutReport:
    """What a cut holds.

    Fields:
        kept: messages.
        unused: frames that were left out because nothing was made of them.
    """

    kept: int
    unused: int


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
    was_complete = completeness(source).complete
    writer = RecordingWriter(target)
    kept = unused = 0
    try:
        for entry in _entries(source, writer, from_ns, to_ns):
            topic = topic_of(entry.key)
            if used is not None and topic is FRAMES and _place(entry) not in used:
                unused += 1
                continue
            writer.write(topic, entry)
            kept += 1
        for name, data in read_attachments(source).items():
            writer.attach(name, mimetypes.guess_type(name)[0] or "application/octet-stream", data, from_ns)
        writer.note(
            CUT, {"of": source.name, "from_ns": str(from_ns), "to_ns": str(to_ns), "unused_frames": str(unused)}
        )
        writer.note(LOSSES, {COMPLETE: str(bool(was_complete) and not unused)})
        writer.close()
    finally:
        writer.abandon()
    return CutReport(kept, unused)


def _entries(source: Path, writer: RecordingWriter, from_ns: int, to_ns: int) -> Iterator[Entry]:
    """The states that held before, then all of the stretch; notes are copied on the way."""
    states: dict[str, Entry] = {}
    begun = False
    for record in read_with_notes(source):
        if isinstance(record, Note):
            if record.name != LOSSES:
                writer.note(record.name, record.facts)
            continue
        if record.received_ns > to_ns:
            continue
        if record.received_ns < from_ns:
            if _topic(record).delivery is Delivery.STATE:
                states[record.key] = record
            continue
        if not begun:
            begun = True
            yield from (replace(state, repeated=True) for state in states.values())
        yield record


def _used_frames(source: Path, from_ns: int, to_ns: int) -> set[_Place]:
    used: set[_Place] = set()
    for entry in read_recording(source):
        if _topic(entry) is not OBSERVATIONS or not from_ns <= entry.received_ns <= to_ns:
            continue
        try:
            consumed = decode(OBSERVATIONS.message, entry.payload).consumed
        except MessageError:
            continue
        used |= {_Place(c.key, c.epoch, c.sequence) for c in consumed}
    return used


def _topic(entry: Entry) -> Topic:
    return topic_of(entry.key)


def _place(entry: Entry) -> _Place:
    return _Place(entry.key, entry.epoch, entry.sequence)
