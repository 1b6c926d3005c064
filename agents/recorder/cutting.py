"""A shorter recording out of a longer one: to show a moment to somebody, to keep what matters, to test with it."""

import contextlib
from collections import Counter
from collections.abc import Iterator, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from agents.recorder.derived_file import DerivedFile, derived_from
from schemas.checks import MessageError, fields_of
from schemas.codec import decode
from schemas.messages import CommandRecord, GraspGoal, GraspPlan
from schemas.topics import COMMANDS, FRAMES, GOAL, PLAN, Delivery, is_known, topic_of
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
    """Write what was received from one moment to another, both included, with what agents there went on from.

    That is the states that held when it began, what the outputs within it were made from, and the plans that arms
    carried out then, with their goals.

    Args:
        only_used_frames: of the camera's frames keep those that something in the stretch was made of.

    Raises:
        RecordingError, OSError: as `read_recording`, or where the target cannot be written.
    """
    said = completeness(source)
    file = DerivedFile(target)
    consumed = _consumed(source, from_ns, to_ns)
    used = consumed if only_used_frames else None
    stretch = _Stretch(from_ns, to_ns, consumed)
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
