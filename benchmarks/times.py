"""The rows of the table of goals that are about time."""

import statistics
from typing import Any

from benchmarks.goals import Goal
from benchmarks.scenes import RENDERS
from benchmarks.variations import NONE

Row = dict[str, Any]

LIMITS_MS = {"paper": 5.0, "refined": 40.0}
"""For observations to curve, by method."""
LIMIT_WITH_CENTRELINES_MS = 60.0
"""For centrelines of both images and the curve, by method `refined`."""

OTHER_STEPS = ("rectify", "segment", "reconstruct")
"""What is left of a run leads from masks to observations."""


def time_goals(method: str, rows: list[Row]) -> list[Goal]:
    """Median times of the renders, which are 960x540, with true masks; segmentation from the runs without masks."""
    renders = [row for row in rows if row["group"] in RENDERS and not row["calibration"]]
    given = [row for row in renders if row["masks"] == "true"]
    segmented = [row for row in renders if row["masks"] == NONE]
    result: list[Goal] = []
    if segmented:
        result.append(Goal("time: segmentation, both images, ms", "-", "-", _median(_ms(segmented, "segment"))))
    if given:
        curve = _ms(given, "reconstruct")
        observed: list[float] = [
            sum(ms for step, ms in row["timings_ms"].items() if step not in OTHER_STEPS) for row in given
        ]
        both = [a + b for a, b in zip(observed, curve, strict=True)]
        with_lines = [row["centrelines_ms"] + ms for row, ms in zip(given, curve, strict=True)]
        result += [
            Goal("time: masks to observations, ms", "-", "-", _median(observed)),
            _limited(f"time: observations to curve, {method}, ms", curve, LIMITS_MS.get(method)),
            _limited(f"time: masks to curve, {method}, with judging the input and encoding, ms", both, None),
        ]
        if method == "refined":
            what = "time: centrelines of both images, and observations to curve, refined, ms"
            result.append(_limited(what, with_lines, LIMIT_WITH_CENTRELINES_MS))
    solved = [row["solvers"] for row in given if row["solvers"]]
    return result + (_solvers(solved) if solved else [])


def _solvers(solved: list[dict[str, dict[str, float]]]) -> list[Goal]:
    """Each solver's median time, how often PIQP's that is, and the worst violation."""
    result: list[Goal] = []
    for solver in solved[0]:
        ms = statistics.median(row[solver]["ms"] for row in solved)
        ratio = statistics.median(row[solver]["ms"] / row["piqp"]["ms"] for row in solved)
        violation = max(row[solver]["violation"] for row in solved)
        figure = f"{ms:.1f} ms, {ratio:.1f} times PIQP, worst violation {violation:.0e}"
        result.append(Goal(f"time: one program of method paper, by {solver}", "-", "-", figure))
    return result


def _limited(what: str, values: list[float], limit: float | None) -> Goal:
    if limit is None:
        return Goal(what, "-", "-", _median(values))
    return Goal(what, "-", f"≤ {limit:g}", _median(values), statistics.median(values) <= limit)


def _ms(rows: list[Row], step: str) -> list[float]:
    return [row["timings_ms"][step] for row in rows]


def _median(values: list[float]) -> str:
    return f"{statistics.median(values):.1f}"
