"""The table of goals that the runs of `benchmarks.accuracy` are judged by."""

import statistics
from collections.abc import Iterable, Sequence

from benchmarks.measures import NEAR_MASK, STRETCHES, coverage_of, topology_is_right
from benchmarks.scenes import BINARY, CLEAR, CROSSING, HIDDEN, NONE, OCCLUSION, REAL, SIM
from benchmarks.tables import Goal, Row

BOUND_OF = {"mean": "bound", "mean seen": "bound seen"}
LEAST_PLACES = 20
"""A scene with fewer places than that has no coverage of its own."""
LIMITS_MS = {"paper": 5.0, "refined": 40.0}
"""For observations to curve, by method."""


def goals(rows: list[Row]) -> list[Goal]:
    """Those rows of the table of goals that these runs have figures for."""
    nominal = [row for row in rows if not row["calibration"]]
    parts = (_sim, _real, _clear, _crossing, _occluded, _calibrated)
    return [goal for part in parts for goal in part(nominal)] + _miscalibrated(rows)


def time_goals(method: str, rows: list[Row]) -> list[Goal]:
    """Median times of clear, crossing and occlusion renders, which are 960x540."""
    result: list[Goal] = []
    for what, step, masks, limit in (
        ("segmentation, both images", "segment", NONE, None),
        (f"observations to curve, {method}", "reconstruct", "true", LIMITS_MS.get(method)),
    ):
        some = [row["timings_ms"][step] for kind in (CLEAR, CROSSING, OCCLUSION) for row in of(rows, kind, masks)]
        if some:
            median = statistics.median(some)
            goal, met = ("-", None) if limit is None else (f"≤ {limit:g}", median <= limit)
            result.append(Goal(f"time: {what}, median, ms", f"{median:.1f}", goal, met))
    return result


def _sim(rows: list[Row]) -> list[Goal]:
    plain = of(rows, SIM, NONE)
    if not plain:
        return []
    failed = failures(plain)
    return [
        Goal("ucsd sim, plain images, no options: failures", str(failed), "0", failed == 0, "1 (2023), 6 (2025)"),
        _two("ucsd sim: mean error, median / worst", plain, "mean", (0.020, 0.06), "0.093 / 0.29 (2023)"),
    ]


def _real(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    for masks in dict.fromkeys(row["masks"] for row in rows if row["group"] == REAL):
        some = of(rows, REAL, masks)
        ok = [row for row in some if row["status"] == "ok"]
        both = [max(row["left to mask"], row["right to mask"]) for row in ok]
        near = min((min(row[name] for name in NEAR_MASK) for row in ok), default=0.0)
        given, all_ok = f"ucsd real, masks {masks}: ", len(ok) == len(some)
        what = given + "curve to thread, worse image, median / worst pair, px"
        met = all_ok and max(both, default=0.0) <= 0.42
        result += [
            Goal(what, spread(both), "≤ 0.42", met, "0.37 to 0.98"),
            Goal(
                given + "mask within 3 px of the curve, worst image", f"{near:.1%}", "≥ 98 %", all_ok and near >= 0.98
            ),
        ]
    return result


def _clear(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    for masks, limits in (("true", (0.05, 0.40)), (BINARY, None), (NONE, None)):
        if some := of(rows, CLEAR, masks):
            name = f"renders without crossings or occlusion, masks {masks}: mean error, median / worst, mm"
            result.append(_two(name, some, "mean", limits, "0.86 / 12.8" if limits else "-"))
    return result


def _crossing(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    for masks in ("true", NONE):
        some, aimed = of(rows, CROSSING, masks), masks == "true"
        if not some:
            continue
        name = f"renders with crossings, masks {masks}: "
        right = sum(topology_is_right(row) for row in some)
        all_right = ("all", right == len(some)) if aimed else ("-", None)
        result += [
            Goal(name + "topology right", f"{right} of {len(some)}", *all_right, published="0"),
            _decided(name, some),
            _two(name + "mean error, median / worst, mm", some, "mean", (None, 0.40) if aimed else None, "1.5 to 5.4"),
            _two(name + "Fréchet, median / worst, mm", some, "frechet", (None, 3.0) if aimed else None),
        ]
    return result


def _occluded(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    for group, masks in ((OCCLUSION, "true"), (HIDDEN, "true"), (OCCLUSION, NONE)):
        some, aimed = of(rows, group, masks), masks == "true"
        if not some:
            continue
        name = f"{group}s, masks {masks}: mean error "
        seen, whole = ((None, 0.15), (None, 1.5)) if aimed else (None, None)
        published = "0.32 to 0.70" if group == OCCLUSION else "-"
        result += [
            _two(name + "where both images see it, median / worst, mm", some, "mean seen", seen),
            _two(name + "whole, median / worst, mm", some, "mean", whole, published),
        ]
        if group == HIDDEN:
            result.append(_decided(f"{group}s, masks {masks}: ", some))
    return result


def _calibrated(rows: list[Row]) -> list[Goal]:
    """Coverage, over what a method is given in the goals above: plain published images, renders with true masks."""
    result: list[Goal] = []
    for name, aimed, some in (
        ("sim, plain, and renders, true masks", True, of(rows, SIM, NONE) + [r for r in rows if r["masks"] == "true"]),
        ("renders, no masks", False, [r for r in rows if r["masks"] == NONE and r["group"] not in (SIM, REAL)]),
    ):
        believed = [row for row in some if row["coverage"]]
        if not believed:
            result += [Goal(f"95 % ellipse ({name})", "none predicted", "93 to 97 %", False, "none")] if aimed else []
            continue
        totals = [coverage_of(row) for row in believed]
        shares = [inside / places for inside, places in totals if places >= LEAST_PLACES]
        result += [
            _within(f"95 % ellipse ({name}), all", _total(totals), (0.93, 0.97), aimed),
            _within(f"95 % ellipse ({name}), worst scene", (min(shares, default=0.0), 1.0), (0.85, 1.0), aimed),
        ]
        for kind in STRETCHES:
            of_kind = _total([row["coverage"][kind] for row in believed])
            if of_kind[1]:
                result.append(_within(f"95 % ellipse ({name}), {kind}", of_kind, (0.90, 0.99), aimed))
    return result


def _miscalibrated(rows: list[Row]) -> list[Goal]:
    what = "renders without crossings or occlusion, true masks, calibration off by"
    return [
        _two(f"{what} {error}: mean error, mm", [row for row in rows if row["calibration"] == error], "mean")
        for error in dict.fromkeys(row["calibration"] for row in rows if row["calibration"])
    ]


def _decided(name: str, rows: list[Row]) -> Goal:
    """How many threads are right, how many say that their course is undecided or that they are none, and the rest."""
    unsure = [row.get("undecided", False) or row["status"] != "ok" for row in rows]
    right = sum(topology_is_right(row) and not doubt for row, doubt in zip(rows, unsure, strict=True))
    what = f"{right} / {sum(unsure)} / {len(rows) - right - sum(unsure)}"
    met = right >= 0.9 * len(rows) and right + sum(unsure) == len(rows)
    return Goal(name + "topology right / undecided or refused / wrong though ok", what, "≥ 90 % / rest / 0", met)


def of(rows: list[Row], group: str, masks: str) -> list[Row]:
    """The rows of one kind of scene with these masks and a right calibration."""
    return [row for row in rows if (row["group"], row["masks"], row["calibration"]) == (group, masks, "")]


def failures(rows: list[Row]) -> int:
    """How many runs gave no curve."""
    return sum(row["status"] != "ok" for row in rows)


def _total(counts: Sequence[Sequence[int]]) -> tuple[int, int]:
    """Places within their ellipse, and places, of several scenes or stretches."""
    return sum(inside for inside, _ in counts), sum(places for _, places in counts)


def _two(
    what: str, rows: list[Row], measure: str, limits: tuple[float | None, float] | None = None, published: str = "-"
) -> Goal:
    """Median and worst of a measure; a failure is as bad as any worst."""
    figure, failed = spread(row[measure] for row in rows), failures(rows)
    figure += f", {failed} of {len(rows)} failed" if failed else ""
    bound = spread(row[BOUND_OF[measure]] for row in rows) if measure in BOUND_OF else ""
    if limits is None:
        return Goal(what, figure, published=published, bound=bound)
    values = [row[measure] for row in rows if row[measure] is not None]
    median, worst = limits
    met = not failed and bool(values) and max(values) <= worst
    met = met and (median is None or statistics.median(values) <= median)
    return Goal(
        what, figure, f"≤ {worst:g}" if median is None else f"≤ {median:g} / ≤ {worst:g}", met, published, bound
    )


def _within(what: str, counts: tuple[float, float], limits: tuple[float, float], aimed: bool) -> Goal:
    (inside, places), (low, high) = counts, limits
    share, goal = inside / places, f"≥ {low:.0%}" if high == 1.0 else f"{low:.0%} to {high:.0%}"
    return Goal(what, f"{share:.1%}", *((goal, low <= share <= high) if aimed else ("-", None)), published="none")


def spread(values: Iterable[float | None]) -> str:
    """Median and worst of what there is."""
    known = [value for value in values if value is not None]
    return f"{statistics.median(known):.3f} / {max(known):.3f}" if known else "-"
