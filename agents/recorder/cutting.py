"""A shorter recording out of a longer one: to show a moment to somebody, to keep what matters, to test with it.

Files that are made of recordings open as a recorder's own do, and say what was done to them.
"""

import contextlib
import mimetypes
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import schemas
from agents.recorder.foxglove import FoxgloveCopies
from schemas.checks import MessageError, fields_of
from schemas.codec import decode, encode
from schemas.messages import CommandRecord, GraspGoal, GraspPlan
from schemas.topics import (
    COMMANDS,
    FRAMES,
    GOAL,
    PLAN,
    ROBOT_STATE,
    TOOL,
    Delivery,
    Topic,
    is_known,
    topic_of,
)
from shared.recording.completeness import Completeness, completeness
from shared.recording.derivation import (
    BEFORE_AND_AFTER,
    BEGUN,
    DERIVED,
    UNKNOWN_TOPICS,
    UNUSED_FRAMES,
    Derivation,
    as_far_as_held,
    digest_of,
    unfinished_of,
)
from shared.recording.entry import Entry, Note, RecordingError
from shared.recording.foxglove_schemas import DESCRIPTORS
from shared.recording.losses import AT, COMPLETE, LOSSES, LOST, counts_of
from shared.recording.mcap_file import UntilDamage, read_attachments, recorded_by
from shared.recording.writer import RecordingWriter


class DerivedFile:
    """Writes a derived recording, with the copies that other programs show.

    Raises:
        OSError: where it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._writer, self._copies = RecordingWriter(path), FoxgloveCopies()
        self._notes, self._held = list[Note](), defaultdict[str, list[int]](list)

    def write(self, topic: Topic, entry: Entry) -> None:
        """Add a message."""
        self._writer.write(topic, entry)
        if not entry.repeated:
            self._held[entry.key].append(entry.received_ns)
        for copy in self._copies.of(topic, entry):
            self._writer.write_derived(copy.channel, copy.schema, DESCRIPTORS, copy.payload, entry)

    def begin(self, derivation: Derivation, attached: Mapping[str, bytes]) -> None:
        """Say what the file is made of, as far as that is known, for one that is cut off before its end."""
        for name, data in attached.items():
            self._writer.attach(name, mimetypes.guess_type(name)[0] or "application/octet-stream", data, 0)
        self._writer.note(BEGUN, derivation.note.facts)

    def note(self, note: Note) -> None:
        """Add a note of the source; what sums up the source is left to `close`.

        So is how many of its messages an agent that ran anew has made; meanwhile the source's derivation is begun.
        """
        if note.name != LOSSES:
            self._notes.append(note)
            self._writer.note(BEGUN if note.name == DERIVED else note.name, note.facts)

    def close(self, derivation: Derivation, complete: bool | None, lost: Mapping[str, int]) -> None:
        """Say what the file was made of and what it lacks, and finish it.

        A source that was cut off has only said at its beginning what it was made of.
        """
        told = [note for note in self._notes if note.name == DERIVED]
        for note in (*told, *unfinished_of(self._notes)):
            self._writer.note(DERIVED, as_far_as_held(note, self._held).facts)
        self._writer.note(DERIVED, derivation.note.facts)
        known = {} if complete is None else {COMPLETE: str(complete and not lost)}
        self._writer.note(LOSSES, {key: str(count) for key, count in lost.items()} | known)
        self._writer.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._writer.abandon()


def derived_from(source: Path, said: Completeness, how: str, **told: Any) -> Derivation:
    """How a file is derived from another, as that is now.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    version = ".".join(map(str, recorded_by(source)))
    read_as = "" if version == schemas.__version__ else version
    return Derivation(how, source.name, digest_of(source), said.sentence, read_as=read_as, **told)


@dataclass(frozen=True)
class CutReport:
    """What a cut holds.

    Fields:
        kept: messages.
        unused: frames that were left out because nothing was made of them.
        source: what the recording that it was cut out of says of itself.
        damage: what broke off the reading of it; empty where all was read.
        moved: the arms whose states were moved in time.
    """

    kept: int
    unused: int
    source: Completeness
    damage: str
    moved: Set[str] = frozenset()


MEASURED = ROBOT_STATE, TOOL
"""What tells when an arm was measured."""


class _Place(NamedTuple):
    key: str
    epoch: int
    sequence: int


def cut(
    source: Path,
    target: Path,
    from_ns: int,
    to_ns: int,
    only_used_frames: bool = False,
    delays_ms: Mapping[str, float] = MappingProxyType({}),
) -> CutReport:
    """Write what was received from one moment to another, both included, with what agents there went on from.

    That is the states that held when it began, what the outputs within it were made from, and the plans that arms
    carried out then, with their goals.

    Args:
        only_used_frames: of the camera's frames keep those that something in the stretch was made of.
        delays_ms: by arm, how much later its states are said to have been measured.

    Raises:
        RecordingError, OSError: as `read_recording`, or where the target cannot be written.
    """
    said = completeness(source)
    file = DerivedFile(target)
    consumed = _consumed(source, from_ns, to_ns)
    used = consumed if only_used_frames else None
    stretch = _Stretch(from_ns, to_ns, consumed)
    kept, unused, moved = 0, 0, set[str]()
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
            arm = entry.key.split("/")[3]
            if topic in MEASURED and arm in delays_ms and (later := _moved(topic, entry, delays_ms[arm])):
                moved.add(arm)
                entry = later  # noqa: PLW2901 - the same message, measured later
            file.write(topic, entry)
            # what is repeated from before the stretch is no message of it
            kept += not entry.repeated
        left_out = {BEFORE_AND_AFTER: stretch.outside, UNKNOWN_TOPICS: stretch.unknown, UNUSED_FRAMES: unused}
        aligned = "".join(f", states of {arm} moved by {delays_ms[arm]:+g} ms" for arm in sorted(moved))
        told = replace(begun, how=stretch.sentence + aligned, left_out={what: n for what, n in left_out.items() if n})
        if stretch.damage:
            told = replace(told, source_said=stretch.damage)
        file.close(told, False if stretch.damage else said.complete, stretch.lost)
    finally:
        file.abandon()
    return CutReport(kept, unused, said, stretch.damage, moved)


def _moved(topic: Topic, entry: Entry, delay_ms: float) -> Entry | None:
    """What is said to have been measured so much later; None where it cannot be read."""
    try:
        state = decode(topic.message, entry.payload)
    except MessageError:
        return None
    return replace(entry, payload=encode(replace(state, measured_ns=state.measured_ns + round(1e6 * delay_ms))))


class _Stretch:
    """Reads a stretch of a recording, and counts what lies outside, and what is known to be lost within."""

    def __init__(self, from_ns: int, to_ns: int, consumed: Set[_Place]) -> None:
        self._from_ns, self._to_ns, self._consumed = from_ns, to_ns, consumed
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
        """What it goes on from, then all of the stretch; notes are copied on the way."""
        states: dict[str, Entry] = {}
        before: dict[_Place, Entry] = {}
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
                if record.received_ns >= self._from_ns:
                    continue
                if _place(record) in self._consumed:
                    before[_place(record)] = record
                if topic_of(record.key).delivery is Delivery.STATE:
                    states[record.key] = record
            else:
                if not begun:
                    begun = True
                    before |= {_place(state): state for state in states.values()}
                    yield from (replace(one, repeated=True) for one in before.values())
                yield record
        self.damage = records.damage

    def _note(self, note: Note, file: DerivedFile) -> None:
        if note.name == LOST:
            at_ns = note.facts.get(AT, "")
            if not (at_ns.isdecimal() and self._from_ns <= int(at_ns) <= self._to_ns):
                return
            self.lost.update(counts_of(note))
        file.note(note)


def _consumed(source: Path, from_ns: int, to_ns: int) -> set[_Place]:
    """What the outputs of a stretch were made from, and the plans that they name, with their goals."""
    consumed, named = set[_Place](), set[str]()
    plans, goals = dict[str, tuple[_Place, str]](), dict[str, _Place]()
    for entry in UntilDamage(source):
        if isinstance(entry, Note) or not is_known(entry.key) or entry.received_ns > to_ns:
            continue
        topic = topic_of(entry.key)
        within = entry.received_ns >= from_ns
        with contextlib.suppress(MessageError):
            if topic is PLAN:
                plan = decode(GraspPlan, entry.payload)
                plans[plan.plan_id] = _place(entry), plan.goal_id
            elif topic is COMMANDS:
                goals |= {name: _place(entry) for name in _goal_in(decode(CommandRecord, entry.payload))}
            if within and {"consumed", "plan_id"} & set(fields_of(topic.message)):
                message = decode(topic.message, entry.payload)
                consumed |= {_Place(one.key, one.epoch, one.sequence) for one in getattr(message, "consumed", ())}
                named.add(getattr(message, "plan_id", ""))
    for place, goal_id in (plans[plan_id] for plan_id in named if plan_id in plans):
        consumed |= {place, *(goals[name] for name in (goal_id,) if name in goals)}
    return consumed


def _goal_in(record: CommandRecord) -> tuple[str, ...]:
    """The id of the goal that a command is, if it is one."""
    return (decode(GraspGoal, record.payload).header.id,) if record.topic == str(GOAL) else ()


def _place(entry: Entry) -> _Place:
    return _Place(entry.key, entry.epoch, entry.sequence)
