"""What the perception benchmark prints."""

import statistics
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.goals import Goal, topology_is_right
from benchmarks.perception_empty import Counts
from benchmarks.scenes import CLEAR, CROSSING
from benchmarks.tables import coverage_of, shown, topology_of

Row = dict[str, Any]

LEAST_ALL, LEAST_WORST = 0.98, 0.93
CLEAR_MEDIAN_MM, WORST_MM = 0.10, 0.60
CROSSING_MM, CROSSING_FRECHET_MM = 0.50, 4.0
INSIDE, LEAST_INSIDE = (0.93, 0.98), 0.80
FALSE_PER_FRAME = 1e-3
FIRST_MS, NEAR_MS = {"network": 80.0, "ridge": 30.0}, {"network": 20.0, "ridge": 10.0}
TIMES = {
    "first": "first frame, both images to centrelines",
    "near": "around the last thread, both images to centrelines",
    "pixels near": "the same where it is not followed",
    "step first": "the agent's step for a first frame, raw images to message",
    "step near": "the agent's step around the last thread, raw images to message",
}


def print_scenes(console: Console, segmenter: str, rows: list[Row]) -> None:
    """One row for each scene."""
    title = f"{segmenter}: centrelines within 2 px; off: of those, rms across the thread, and as perception says"
    table = Table(title=title, title_justify="left")
    for column in ("scene", "kind", "status"):
        table.add_column(column, no_wrap=True)
    numbers = ("recall", "precision", "off px", "said px", "mean mm", "seen mm", "frechet", "in ellipse")
    for column in (*numbers, "topology", "first ms", "near ms", "tracked"):
        table.add_column(column, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(
            *(row["scene"], row["group"].removesuffix(" render"), row["status"]),
            *(f"{share:.1%}" for share in (recall(row), precision(row))),
            *(shown(row[name]) for name in ("off px", "said px", "mean", "mean seen", "frechet")),
            *(coverage_of(row), topology_of(row)),
            *(shown_ms(row, name) for name in ("first", "near", "tracked")),
        )
    console.print(table)
    for row in rows:
        if row["reason"]:
            console.print(f"  {row['scene']}: {row['reason']}")


def print_goals(console: Console, segmenter: str, rows: list[Row], empty: Counts | None) -> None:
    """The table of goals of one segmenter."""
    table = Table("what", "goal", "here", "", title=f"goals, {segmenter}", title_justify="left")
    of_scenes = [*_shares(rows), *_curves(rows), *_believed(rows)] if rows else []
    found = [*of_scenes, *_empty(empty), *_times(segmenter, rows)]
    for goal in found:
        verdict = {True: "[green]met[/]", False: "[red]not met[/]", None: ""}[goal.met]
        table.add_row(goal.what, goal.goal, goal.figure, verdict)
    console.print(table)


def recall(row: Row) -> float:
    """The share of the thread's true centreline in both images that was found."""
    return row["found"] / max(row["true"], 1)


def precision(row: Row) -> float:
    """The share of what was found in both images that lies on the thread."""
    return row["right"] / max(row["given"], 1)


def shown_ms(row: Row, name: str) -> str:
    """A time of a row, where it was measured."""
    value = row.get("times_ms", {}).get(name)
    return "-" if value is None else f"{value:.0f}" if name == "tracked" else f"{value:.1f}"


def _shares(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    shares: tuple[tuple[str, str, str, Callable[[Row], float]], ...] = (
        ("recall", "found", "true", recall),
        ("precision", "right", "given", precision),
    )
    for name, part, whole, of in shares:
        share = sum(row[part] for row in rows) / max(sum(row[whole] for row in rows), 1)
        worst = min(rows, key=of)
        goal = f"≥ {LEAST_ALL:.0%}"
        result.append(Goal(f"centreline within 2 px, {name}, all scenes", "", goal, f"{share:.2%}", share >= LEAST_ALL))
        figure = f"{of(worst):.1%} ({worst['scene']})"
        what = f"centreline within 2 px, {name}, worst scene"
        result.append(Goal(what, "", f"≥ {LEAST_WORST:.0%}", figure, of(worst) >= LEAST_WORST))
    failed = sum(row["status"] != "ok" for row in rows)
    result.append(Goal("scenes without a curve", "", "0", f"{failed} of {len(rows)}", failed == 0))
    return result


def _curves(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    if clear := _known([row for row in rows if row["group"] == CLEAR], "mean"):
        median = statistics.median(row["mean"] for row in clear)
        what = "mean curve error, median of scenes without crossings or occlusion, mm"
        result.append(Goal(what, "", f"≤ {CLEAR_MEDIAN_MM:g}", f"{median:.3f}", median <= CLEAR_MEDIAN_MM))
    if seen := _known(rows, "mean seen"):
        result.append(_worst("mean curve error of visible parts, worst scene, mm", seen, "mean seen", WORST_MM))
    if crossing := _known([row for row in rows if row["group"] == CROSSING], "mean"):
        right = sum(topology_is_right(row) for row in crossing)
        result += [
            _worst("scenes with crossings: mean error, worst, mm", crossing, "mean", CROSSING_MM),
            _worst("scenes with crossings: Fréchet, worst, mm", crossing, "frechet", CROSSING_FRECHET_MM),
            Goal(
                "scenes with crossings: topology right",
                "",
                "all",
                f"{right} of {len(crossing)}",
                right == len(crossing),
            ),
        ]
    return result


def _known(rows: list[Row], measure: str) -> list[Row]:
    return [row for row in rows if row[measure] is not None]


def _worst(what: str, rows: list[Row], measure: str, limit: float) -> Goal:
    worst = max(rows, key=lambda row: row[measure])
    return Goal(what, "", f"≤ {limit:g}", f"{worst[measure]:.3f} ({worst['scene']})", worst[measure] <= limit)


def _believed(rows: list[Row]) -> list[Goal]:
    counted = {
        row["scene"]: [sum(column) for column in zip(*row["coverage"].values(), strict=True)]
        for row in rows
        if row["coverage"]
    }
    if not counted:
        return []
    share = sum(inside for inside, _ in counted.values()) / sum(places for _, places in counted.values())
    worst = min(counted, key=lambda scene: counted[scene][0] / counted[scene][1])
    least = counted[worst][0] / counted[worst][1]
    low, high = INSIDE
    return [
        Goal("95 % ellipse, all scenes", "", f"{low:.0%} to {high:.0%}", f"{share:.1%}", low <= share <= high),
        Goal("95 % ellipse, worst scene", "", f"≥ {LEAST_INSIDE:.0%}", f"{least:.1%} ({worst})", least >= LEAST_INSIDE),
    ]


def _empty(empty: Counts | None) -> list[Goal]:
    if empty is None:
        return []
    every = {
        name: sum(of_kind[name] for of_kind in empty.values()) for name in ("frames", "perception", "reconstruction")
    }
    met = every["perception"] <= FALSE_PER_FRAME * max(every["frames"], 1 / FALSE_PER_FRAME)
    result = [Goal("false threads in thread-free frames", "", "≤ 1 of 1000", _said(every), met)]
    return result + [Goal(f"of these, in {kind}", "", "", _said(of_kind), None) for kind, of_kind in empty.items()]


def _said(counts: dict[str, int]) -> str:
    return f"{counts['perception']} of {counts['frames']}, {counts['reconstruction']} of them with a curve"


def _times(segmenter: str, rows: list[Row]) -> list[Goal]:
    limits = {"first": FIRST_MS.get(segmenter), "near": NEAR_MS.get(segmenter)}
    result: list[Goal] = []
    for name, what in TIMES.items():
        wall, processor = (
            [row["times_ms"][key] for row in rows if key in row.get("times_ms", {})] for key in (name, name + " cpu")
        )
        if not wall:
            continue
        median, limit = statistics.median(wall), limits.get(name)
        figure = f"{median:.1f}, of the processor {statistics.median(processor):.1f}"
        goal = "" if limit is None else f"≤ {limit:g}"
        result.append(Goal(f"time, median, ms: {what}", "", goal, figure, None if limit is None else median <= limit))
    return result
