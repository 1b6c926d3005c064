"""What is said of a replay through agents: a table of what differs, and both side by side as one Rerun file."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.configuration.rig import RigConfig
from agents.replay.compare import OTHER
from agents.replay.differences import FIGURES, Comparison, Row
from agents.replay.through import Outcome
from agents.viewer.entity import Moment
from agents.viewer.side_by_side import RECORDED, REPLAYED, SideBySide
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.topics import FRAMES, LOG, TOPICS, Topic, topic_of
from shared.recording.completeness import Completeness
from shared.recording.mcap_file import Entry, Note
from shared.runtime.replay import Place, place_of

LONGEST_WORDS = 60
"""Of a reason, whose whole is told in the lines below the heading."""
MOST_CHANGES = 5
HEADINGS = ("field", "messages", "beyond", "median", "worst", "tolerance", "", "the worst is at")


def table(comparison: Comparison, began_ns: int) -> list[str]:
    """A block of lines for each topic: what was compared, and a row for every field that differs anywhere."""
    lines: list[str] = []
    order = {str(topic): number for number, topic in enumerate(TOPICS)}
    messages = Counter(output.topic for output in comparison.outputs)
    differing = Counter(output.topic for output in comparison.outputs if not output.is_same)
    for topic in sorted(messages, key=lambda name: order[name]):
        rows = [row for row in comparison.rows if row.topic == topic]
        lines += ["", f"{topic}: {messages[topic]} compared, {differing[topic]} not byte for byte the same"]
        lines += _changes(comparison, topic)
        lines += _beside(comparison, topic, bool(rows), differing[topic])
        lines += _aligned([HEADINGS, *(_cells(row, began_ns) for row in rows)]) if rows else []
    return [*lines, ""]


def _beside(comparison: Comparison, topic: str, has_rows: bool, differing: int) -> list[str]:
    """What is not in the rows, and why."""
    of_topic = [output for output in comparison.outputs if output.topic == topic]
    lines: list[str] = []
    if turned := sum(output.turned for output in of_topic):
        lines.append(f"  all else in {'it' if turned == 1 else f'those {turned}'} follows from that")
    if untold := sorted({field for output in of_topic for field in output.untold}):
        lines.append(f"  empty as another version made it, and not compared: {', '.join(untold)}")
    if differing and not has_rows and not lines:
        lines.append("  nothing that is compared differs: it was made of other messages, or at another time")
    return lines


def _changes(comparison: Comparison, topic: str) -> list[str]:
    """What became of how many outputs, the most frequent change first."""
    changed = [output.became for output in comparison.outputs if output.topic == topic and output.became]
    kinds = [_kind(change) for change in changed]
    became = Counter(kinds)
    # where only figures tell them apart they are one kind, and none of them stands for all
    alike = {kind: {change for change, own in zip(changed, kinds, strict=True) if own == kind} for kind in became}
    lines = [
        f"  {'once' if count == 1 else f'{count} times'} {kind if len(alike[kind]) > 1 else min(alike[kind])}"
        for kind, count in became.most_common(MOST_CHANGES)
    ]
    left = len(became) - MOST_CHANGES
    return [*lines, *([f"  and {left} other changes of status or reason"] if left > 0 else [])]


def _kind(change: str) -> str:
    """A change without its figures; one that is of figures alone as it is."""
    kind = FIGURES.sub("#", change)
    before, _, after = kind.partition(" → ")
    return change if before == after else kind


def _cells(row: Row, began_ns: int) -> tuple[str, ...]:
    mark = "!" if row.beyond else ""
    numbers = (_shown(row.median), _shown(row.worst), _shown(row.rule.tolerance))
    frame = "" if row.where.frame is None else f"frame {row.where.frame}, "
    where = f"{frame}{1e-9 * (row.where.published_ns - began_ns):.2f} s"
    unit = "" if math.isinf(row.worst) and not row.rule.tolerance else row.rule.unit
    words = f": {row.words}" if row.words and len(row.words) <= LONGEST_WORDS else ""
    return (f"{row.field}{mark}", str(row.messages), str(row.beyond), *numbers, unit, where + words)


def _shown(amount: float) -> str:
    """A difference in few digits; what no number tells apart is called other."""
    return "other" if amount == OTHER else f"{amount:.3g}"


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    numeric = range(1, 6)
    return [
        "  "
        + "  ".join(
            cell.rjust(width) if column in numeric else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


@dataclass(frozen=True)
class ThroughResult:
    """What came of a replay.

    Fields:
        before, after: the recording, and the recording with the replayed outputs.
        notes: of the recording.
        exactly: whether nothing may differ.
        otherwise: what is otherwise than when the recording was made.
        recorded, used: the configuration of the recording, None where it has none, and of the replay.
        said: what the recording says of what it was made of, and of what it lacks.
        unknown: messages under keys that this version does not know.
        damage: what broke the reading of it off; empty where all was read.
        wall_s: from the first byte read to the last field compared.
    """

    before: list[Entry]
    after: list[Entry]
    notes: list[Note]
    outcomes: list[Outcome]
    comparison: Comparison
    exactly: bool
    otherwise: str
    recorded: RigConfig | None
    used: RigConfig
    said: Completeness
    unknown: int
    damage: str
    wall_s: float

    @property
    def step_s(self) -> float:
        """What the steps took together."""
        return sum(outcome.step_s for outcome in self.outcomes)


def report(result: ThroughResult) -> Iterator[str]:
    """The lines of the report: what was repeated, what differs, and how long it took."""
    for outcome in result.outcomes:
        yield _sentence(outcome, {place_of(entry) for entry in result.before})
    comparison = result.comparison
    if comparison.made_no_more:
        gone = Counter(
            str(topic_of(one.key)) for outcome in result.outcomes for one in outcome.compared if one.now is None
        )
        of = ", ".join(f"{count} of {topic}" for topic, count in sorted(gone.items()))
        yield f"{comparison.made_no_more} recorded outputs are made no more ({of})"
    if comparison.unrecorded:
        yield f"{comparison.unrecorded} outputs are made that were not recorded"
    if result.otherwise:
        how = "nothing may differ all the same" if result.exactly else "compared within tolerances"
        yield f"otherwise than recorded: {result.otherwise}; {how}"
    # when the recording begins, as `inspect` has it; what it repeats from before is older
    began_ns = next((entry.at_ns for entry in result.before if not entry.repeated), 0)
    yield from table(comparison, began_ns)
    if comparison.is_same:
        yield "all that was compared is the same" + ("" if result.exactly else ", within tolerance")
    steps = sum(len(outcome.steps_ms) for outcome in result.outcomes)
    ratio = f", {result.wall_s / result.step_s:.2f} times as long" if result.step_s else ""
    yield f"{steps} steps took {result.step_s:.2f} s; the whole replay {result.wall_s:.2f} s{ratio}"


def _sentence(outcome: Outcome, recorded: Set[Place]) -> str:
    """What became of one agent's outputs, in one line."""
    there = outcome.compared
    if not outcome.outputs:
        return f"{outcome.stage}: said nothing in this recording"
    same = sum(output.same for output in there)
    text = f"{outcome.stage}: {len(there)} of {len(outcome.outputs)} outputs repeated, {same} byte for byte the same"
    if outcome.unrepeatable:
        text += f"; {len(outcome.unrepeatable)} cannot be repeated: {lacking(outcome, recorded)}"
    if outcome.steps_ms:
        p50, p99 = np.percentile(outcome.steps_ms, (50, 99))
        text += f"; a step took {p50:.1f} ms (p50), {p99:.1f} ms (p99)"
    if outcome.faults:
        text += f"; {outcome.faults} steps failed, first: {outcome.first_fault}"
    return text


def lacking(outcome: Outcome, recorded: Set[Place]) -> str:
    """What the recording lacks, or the replay makes no more, by key, each message counted once."""
    places = {place_of(c) for output in outcome.unrepeatable for c in output.missing}

    def counted(some: Set[Place]) -> str:
        counts = Counter(key for key, _, _ in some)
        return ", ".join(f"{count} of {key}" for key, count in sorted(counts.items()))

    parts = [f"the recording lacks {counted(places - recorded)}"] if places - recorded else []
    return "; ".join(
        [*parts, *([f"the replay makes no more {counted(places & recorded)}"] if places & recorded else [])]
    )


MOST_CURVES = 4
"""Views of differences beside each other; the others can be opened from the list of entities."""


def write_side_by_side(path: Path, before: list[Entry], after: list[Entry], comparison: Comparison) -> None:
    """Write a Rerun file with both; of the frames those that something was made of.

    Raises:
        ViewerError: where it cannot be written.
    """
    file = SideBySide(path, "replay", curves_of(comparison))
    used = _frames_of(before) | _frames_of(after)
    for side, entries in ((RECORDED, before), (REPLAYED, after)):
        for entry in entries:
            topic = topic_of(entry.key)
            message = None if topic is LOG else _decoded(topic, entry)
            if message is None or (topic is FRAMES and message.stamp.sequence not in used):
                continue
            file.show(side, topic, entry.key, message, entry.published_ns)
    for output in comparison.outputs:
        # of a field that differs anywhere the curve is 0 where it does not
        rows = [row for row in comparison.rows if row.topic == output.topic]
        fields = {f"{row.topic}/{row.field}": 0.0 for row in rows}
        fields |= {f"{output.topic}/{difference.field}": difference.amount for difference in output.fields}
        for field, amount in fields.items():
            at = output.at
            file.differ(Moment(at.published_ns if at.capture_ns is None else at.capture_ns, at.frame), field, amount)
    file.close()


def curves_of(comparison: Comparison) -> tuple[str, ...]:
    """The fields that are shown at once: those beyond their tolerance most often; no two of them nested."""
    rows = [row for row in comparison.rows if "." not in row.field]
    rows.sort(key=lambda row: (-row.beyond, not row.rule.unit))
    return tuple(f"{row.topic}/{row.field}" for row in rows[:MOST_CURVES])


def _frames_of(entries: Iterable[Entry]) -> set[int]:
    """The frames that anything but a frame descends from."""
    found: set[int] = set()
    for entry in entries:
        topic = topic_of(entry.key)
        if topic is not FRAMES and "stamp" in topic.message.__dataclass_fields__:
            message = _decoded(topic, entry)
            found |= {message.stamp.sequence} if message is not None else set()
    return found


def _decoded(topic: Topic, entry: Entry) -> Any:
    """The message; None where it is none, which what it is compared with has said already."""
    try:
        return decode(topic.message, entry.payload)
    except MessageError:
        return None
