"""The table of what a replay says differently."""

import math
from collections import Counter

from agents.replay.compare import OTHER
from agents.replay.differences import FIGURES, Comparison, Row
from schemas.topics import TOPICS

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
