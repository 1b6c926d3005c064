"""What the accuracy benchmark prints."""

from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.measures import OF_EDGE, REPROJECTION, Goal, failures, spread, topology_is_right

CONSOLE = Console(width=260)
TEXT = ("scene", "masks", "calibration", "by", "status", "topology")
MEASURES = (
    "mean",
    "bound",
    "pixel bound",
    "mean seen",
    "bound seen",
    "95 %",
    "max",
    "frechet",
    "end error",
    "length error",
    *OF_EDGE,
    *REPROJECTION,
)

Row = dict[str, Any]


def print_group(group: str, rows: list[Row]) -> None:
    """One table of a kind of scene, and its sums for each kind of masks and calibration."""
    published = list(dict.fromkeys(column for row in rows for column in row["published"]))
    measures = [measure for measure in MEASURES if any(row[measure] is not None for row in rows)]
    table = Table(title=f"{group}: lengths in the calibration's unit, reprojection in px", title_justify="left")
    columns = (*TEXT, "n", *measures, "coverage", "ms", *(f"published {column}" for column in published))
    for column in columns:
        table.add_column(column, justify="left" if column in TEXT else "right", no_wrap=column in TEXT)
    for row in rows:
        table.add_row(
            *(row["scene"], row["masks"], row["calibration"], row["segmenter"], row["status"], topology_of(row)),
            str(row["observations"]),
            *(shown(row[measure]) for measure in measures),
            coverage_of(row),
            f"{row['ms']:.0f}",
            *(shown(row["published"].get(column)) for column in published),
        )
    CONSOLE.print(table)
    for row in rows:
        if row["reason"]:
            CONSOLE.print(f"  {' '.join(filter(None, key(row)[1:]))}: {row['reason']}")
    for kind in dict.fromkeys((row["masks"], row["calibration"]) for row in rows):
        CONSOLE.print(
            f"  {summed(*kind, [row for row in rows if (row['masks'], row['calibration']) == kind], published)}"
        )
    CONSOLE.print()


def topology_of(row: Row) -> str:
    """Right, or which of the order and the crossings is wrong; empty where that is unknown."""
    if row["in order"] is None:
        return ""
    if topology_is_right(row):
        return "right"
    return f"{'order right' if row['in order'] else 'order wrong'}, {row['crossings']} of {row['true crossings']} X"


def coverage_of(row: Row) -> str:
    """The share of all places within their ellipse."""
    if not row["coverage"]:
        return "-"
    inside, places = (sum(column) for column in zip(*row["coverage"].values(), strict=True))
    return f"{inside / places:.0%}"


def summed(masks: str, calibration: str, rows: list[Row], published: list[str]) -> str:
    """Failures, and median and worst of each measure, here and as published on the same scenes."""
    parts = [f"masks {masks}{', calibration off: ' + calibration if calibration else ''}"]
    parts.append(f"{len(rows)} scenes, {failures(rows)} failed")
    for name in ("mean", "bound", "pixel bound", *REPROJECTION):
        if any(row[name] is not None for row in rows):
            parts.append(f"{name} {spread(row[name] for row in rows)}")
    parts.append(f"time {spread((row['ms'] for row in rows), digits=0)} ms")
    for column in published:
        values = [row["published"].get(column) for row in rows]
        parts.append(f"published {column}: {spread(values)}, {sum(value is None for value in values)} failed")
    return "; ".join(parts)


def print_goals(method: str, goals: list[Goal]) -> None:
    """The table of goals."""
    table = Table(title=f"goals, method {method}", title_justify="left")
    for column in ("what", "published by others", "goal", "here", "", "bound for centroids"):
        table.add_column(column)
    for goal in goals:
        verdict = {True: "[green]met[/]", False: "[red]not met[/]", None: ""}[goal.met]
        table.add_row(goal.what, goal.published, goal.goal, goal.figure, verdict, goal.bound)
    CONSOLE.print(table)


def compare(before: list[Row], now: list[Row]) -> None:
    """Print which runs changed their status, or their mean error by more than a tenth, against the baseline."""
    known = {key(row): row for row in before}
    for row in now:
        old = known.get(key(row))
        if old is None:
            continue
        was, now_is = old["mean"], row["mean"]
        moved = was is not None and now_is is not None and abs(now_is - was) > 0.1 * was
        if old["status"] != row["status"] or moved:
            what = " ".join(filter(None, key(row)))
            CONSOLE.print(f"changed: {what}: {old['status']} {shown(was)} -> {row['status']} {shown(now_is)}")


def key(row: Row) -> tuple[str, ...]:
    """What tells a run from all others."""
    return row["group"], row["scene"], f"masks {row['masks']}", row["calibration"]


def shown(value: float | None) -> str:
    """A figure as the table prints it."""
    return "-" if value is None else f"{value:.3f}"
