"""The rows of the table of goals, each with its figure from all runs and whether it is met."""

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.measures import NEAR_MASK, STRETCHES
from benchmarks.scenes import BOARD, CLEAR, CROSSING, HIDDEN, OCCLUSION, REAL, SIM
from benchmarks.variations import BINARY, NONE

Row = dict[str, Any]

BOUND_OF = {"mean": "bound", "mean seen": "bound seen"}
LEAST_PLACES = 20
"""A scene with fewer places than that has no coverage of its own."""


@dataclass(frozen=True)
class Goal:
    """One row: what is measured, what the method's authors reach, what is aimed at, and what came out.

    `met` is None where there is no goal, `bound` what the images allow on the same runs, where that is known.
    """

    what: str
    published: str
    goal: str
    figure: str
    met: bool | None = None
    bound: str = ""


def goals(rows: list[Row]) -> list[Goal]:
    """Those rows of the table of goals that these runs have figures for."""
    nominal = [row for row in rows if not row["calibration"]]
    parts = (_sim, _real, _clear, _crossing, _occluded, _board, _calibrated)
    return [goal for part in parts for goal in part(nominal)] + _miscalibrated(rows)


def _sim(rows: list[Row]) -> list[Goal]:
    plain = of(rows, SIM, NONE)
    if not plain:
        return []
    failed = failures(plain)
    return [
        Goal("ucsd sim, plain images, no options: failures", "1 (2023), 6 (2025)", "0", str(failed), failed == 0),
        _two("ucsd sim: mean error, median / worst", "0.093 / 0.29 (2023)", plain, "mean", (0.020, 0.06)),
    ]


def _real(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    for masks in dict.fromkeys(row["masks"] for row in rows if row["group"] == REAL):
        some = of(rows, REAL, masks)
        both = [max(values) for row in some if None not in (values := [row["left to mask"], row["right to mask"]])]
        near = [min(values) for row in some if None not in (values := [row[name] for name in NEAR_MASK])]
        given = f"ucsd real, masks {masks}: "
        result += [
            _limit(given + "curve to thread, worse image, median / worst pair, px", "0.37 to 0.98", both, 0.42, some),
            Goal(
                given + "mask within 3 px of the curve, worst image",
                "-",
                "≥ 98 %",
                f"{min(near):.1%}" if near else "-",
                len(near) == len(some) and min(near) >= 0.98,
            ),
        ]
    return result


def _clear(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    for masks, limits in (("true", (0.05, 0.40)), (BINARY, None), (NONE, None)):
        if some := of(rows, CLEAR, masks):
            name = f"renders without crossings or occlusion, masks {masks}: mean error, median / worst, mm"
            result.append(_two(name, "0.86 / 12.8" if limits else "-", some, "mean", limits))
    return result


def _crossing(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    for masks in ("true", NONE):
        some, aimed = of(rows, CROSSING, masks), masks == "true"
        if not some:
            continue
        name = f"renders with crossings, masks {masks}: "
        right = sum(topology_is_right(row) for row in some)
        what = f"{right} of {len(some)}"
        result += [
            Goal(name + "topology right", "0", "all" if aimed else "-", what, right == len(some) if aimed else None),
            _decided(name, some),
            _two(name + "mean error, median / worst, mm", "1.5 to 5.4", some, "mean", (None, 0.40) if aimed else None),
            _two(name + "Fréchet, median / worst, mm", "-", some, "frechet", (None, 3.0) if aimed else None),
        ]
    return result


def _occluded(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    for group, masks in ((OCCLUSION, "true"), (HIDDEN, "true"), (OCCLUSION, NONE)):
        some, aimed = of(rows, group, masks), masks == "true"
        if not some:
            continue
        name = f"{group}s, masks {masks}: mean error "
        here = "0.32 to 0.70" if group == OCCLUSION else "-"
        seen, whole = ((None, 0.15), (None, 1.5)) if aimed else (None, None)
        result += [
            _two(name + "where both images see it, median / worst, mm", "-", some, "mean seen", seen),
            _two(name + "whole, median / worst, mm", here, some, "mean", whole),
        ]
        if group == HIDDEN:
            result.append(_decided(f"{group}s, masks {masks}: ", some))
    return result


def _board(rows: list[Row]) -> list[Goal]:
    """Edges across the rows, and those within 15° of them, where disparity says next to nothing."""
    result: list[Goal] = []
    edges = [row for row in rows if row["group"] == BOARD]
    for name, some in (
        ("across the rows", [row for row in edges if not row["parallel"]]),
        ("along the rows", [row for row in edges if row["parallel"]]),
    ):
        if some:
            apart = [row | {"share": _percent(row["length share"])} for row in some]
            own = [row | {"share": _percent(row["length against corners"])} for row in some]
            corners = spread(_percent(row["corners share"]) for row in some)
            result += [
                _two(
                    f"board edges {name}: rms off a straight line, median / worst, mm",
                    "-",
                    some,
                    "straightness",
                    (None, 0.10),
                ),
                _two(f"board edges {name}: length error, median / worst, %", "-", apart, "share", (None, 0.5)),
                _two(f"board edges {name}: length against their own end corners, %", "-", own, "share"),
                Goal(f"board edges {name}: length error of their end corners alone, %", "-", "-", corners),
            ]
    return result


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * abs(share)


def _calibrated(rows: list[Row]) -> list[Goal]:
    """Coverage, over what a method is given in the goals above: plain published images, renders with true masks."""
    result: list[Goal] = []
    for name, aimed, some in (
        ("sim, plain, and renders, true masks", True, of(rows, SIM, NONE) + [r for r in rows if r["masks"] == "true"]),
        ("renders, no masks", False, [r for r in rows if r["masks"] == NONE and r["group"] not in (SIM, REAL)]),
    ):
        believed = [row for row in some if row["coverage"]]
        if not believed:
            result += [Goal(f"95 % ellipse ({name})", "none", "93 to 97 %", "none predicted", False)] if aimed else []
            continue
        totals = [_totals(row["coverage"].values()) for row in believed]
        shares = [inside / places for inside, places in totals if places >= LEAST_PLACES]
        result += [
            _within(f"95 % ellipse ({name}), all", *_totals(totals), (0.93, 0.97), aimed),
            _within(f"95 % ellipse ({name}), worst scene", min(shares, default=0.0), 1.0, (0.85, 1.0), aimed),
        ]
        for kind in STRETCHES:
            inside, places = _totals(row["coverage"][kind] for row in believed)
            if places:
                result.append(_within(f"95 % ellipse ({name}), {kind}", inside, places, (0.90, 0.99), aimed))
        nll = statistics.median(row["nll"] for row in believed)
        result.append(Goal(f"negative log likelihood ({name}), median scene", "none", "-", f"{nll:.2f}"))
    return result


def _miscalibrated(rows: list[Row]) -> list[Goal]:
    wrong = [row for row in rows if row["calibration"]]
    return [
        _two(
            f"renders without crossings or occlusion, true masks, calibration off by {error}: mean error, mm",
            "-",
            [row for row in wrong if row["calibration"] == error],
            "mean",
        )
        for error in dict.fromkeys(row["calibration"] for row in wrong)
    ]


def _decided(name: str, rows: list[Row]) -> Goal:
    """How many threads are right, how many say that their course is undecided or that they are none, and the rest."""
    unsure = [row.get("undecided", False) or row["status"] != "ok" for row in rows]
    right = sum(topology_is_right(row) and not doubt for row, doubt in zip(rows, unsure, strict=True))
    what = f"{right} / {sum(unsure)} / {len(rows) - right - sum(unsure)}"
    met = right >= 0.9 * len(rows) and right + sum(unsure) == len(rows)
    return Goal(name + "topology right / undecided or refused / wrong though ok", "-", "≥ 90 % / rest / 0", what, met)


def topology_is_right(row: Row) -> bool:
    """Whether a run has the thread's order, and as many crossings as it should."""
    return bool(row["in order"]) and row["crossings"] == row["true crossings"]


def of(rows: list[Row], group: str, masks: str) -> list[Row]:
    """The rows of one kind of scene with these masks."""
    return [row for row in rows if row["group"] == group and row["masks"] == masks]


def failures(rows: list[Row]) -> int:
    """How many runs gave no curve."""
    return sum(row["status"] != "ok" for row in rows)


def _totals(counts: Iterable[Sequence[int]]) -> tuple[int, int]:
    """Places within their ellipse, and places, of several scenes or stretches."""
    inside, places = zip(*counts, strict=True)
    return sum(inside), sum(places)


def _two(
    what: str,
    published: str,
    rows: list[Row],
    measure: str,
    limits: tuple[float | None, float] | None = None,
    digits: int = 3,
) -> Goal:
    """Median and worst of a measure; a failure is as bad as any worst."""
    figure = spread((row[measure] for row in rows), digits)
    failed = failures(rows)
    figure += f", {failed} of {len(rows)} failed" if failed else ""
    bound = spread((row[BOUND_OF[measure]] for row in rows), digits) if measure in BOUND_OF else ""
    if limits is None:
        return Goal(what, published, "-", figure, bound=bound)
    values = [row[measure] for row in rows if row[measure] is not None]
    median, worst = limits
    met = not failed and bool(values) and max(values) <= worst
    met = met and (median is None or statistics.median(values) <= median)
    goal = f"≤ {worst:g}" if median is None else f"≤ {median:g} / ≤ {worst:g}"
    return Goal(what, published, goal, figure, met, bound)


def _limit(what: str, published: str, values: list[float], limit: float, rows: list[Row]) -> Goal:
    met = len(values) == len(rows) and max(values) <= limit
    return Goal(what, published, f"≤ {limit:g}", spread(values), met)


def _within(what: str, inside: float, places: float, limits: tuple[float, float], aimed: bool) -> Goal:
    share, (low, high) = inside / places, limits
    goal = f"≥ {low:.0%}" if high == 1.0 else f"{low:.0%} to {high:.0%}"
    return Goal(what, "none", goal if aimed else "-", f"{share:.1%}", low <= share <= high if aimed else None)


def spread(values: Iterable[float | None], digits: int = 3) -> str:
    """Median and worst of what there is."""
    known = [value for value in values if value is not None]
    return f"{statistics.median(known):.{digits}f} / {max(known):.{digits}f}" if known else "-"
