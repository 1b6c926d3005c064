"""What is said of a replay through agents."""

from collections import Counter
from collections.abc import Iterator, Set
from dataclasses import dataclass

import numpy as np

from agents.cli.recordings.difference_table import table
from agents.configuration.rig import RigConfig
from agents.replay.differences import Comparison
from agents.replay.through import Outcome
from schemas.topics import topic_of
from shared.recording.completeness import Completeness
from shared.recording.mcap_file import Entry, Note
from shared.runtime.replay import Place, place_of


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
    yield from table(comparison, _began_ns(result.before))
    if comparison.is_same:
        yield "all that was compared is the same" + ("" if result.exactly else ", within tolerance")
    steps = sum(len(outcome.steps_ms) for outcome in result.outcomes)
    ratio = f", {result.wall_s / result.step_s:.2f} times as long" if result.step_s else ""
    yield f"{steps} steps took {result.step_s:.2f} s; the whole replay {result.wall_s:.2f} s{ratio}"


def _began_ns(entries: list[Entry]) -> int:
    """When the recording begins, as `inspect` has it; what it repeats from before is older."""
    return next((entry.at_ns for entry in entries if not entry.repeated), 0)


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
