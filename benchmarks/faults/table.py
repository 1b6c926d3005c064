"""The table of what faults did, beside what they may do."""

from rich.table import Table

from tests.rigs.faults.faults import Fault
from tests.rigs.faults.trial import Seen

HOLDS_MS, RECOVERS_S = 250.0, 2.0


def table_of(seen: list[Seen], faults: list[Fault]) -> Table:
    """A row a fault; what misses a goal is red."""
    table = Table(title=f"goals: holds within {HOLDS_MS:.0f} ms, recovers within {RECOVERS_S:g} s, loses no event")
    for column in ("fault", "grasp", "held after ms", "start-up s", "recovery s", "events lost", "named by"):
        table.add_column(column, justify="left" if column in ("fault", "grasp", "named by") else "right")
    by_name = {fault.name: fault for fault in faults}
    for one in seen:
        fault = by_name[one.fault]
        table.add_row(
            one.fault,
            one.ended,
            _marked("-" if one.held_ms is None else f"{one.held_ms:.0f}", holds_in_time(one, fault)),
            "-" if one.startup_s is None else f"{one.startup_s:.1f}",
            _marked(_recovery(one), recovers_in_time(one)),
            _marked(str(sum(one.lost.values())), not one.lost),
            one.name or ("nothing to name" if not one.said else "[red]nobody[/]"),
        )
    return table


def holds_in_time(seen: Seen, fault: Fault) -> bool:
    """Whether the arm held as soon as it must, where it must."""
    return not fault.holds or (seen.held_ms is not None and seen.held_ms <= HOLDS_MS)


def recovers_in_time(seen: Seen) -> bool:
    """Whether everything flowed again soon enough."""
    return bool(seen.recovery_s) and all(s is not None and s <= RECOVERS_S for s in seen.recovery_s.values())


def _recovery(seen: Seen) -> str:
    """The slowest flow."""
    if not seen.recovery_s:
        return "-"
    name, slowest = max(seen.recovery_s.items(), key=lambda flow: float("inf") if flow[1] is None else flow[1])
    return f"{name} never" if slowest is None else f"{slowest:.1f}"


def _marked(text: str, good: bool) -> str:
    return text if good else f"[red]{text}[/]"
