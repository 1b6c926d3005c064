"""Every measure of one run as plain values, None where it cannot be had, and the table of goals made of all runs.

Topology: whether a curve visits the places of the true thread in their order, and how often its picture crosses itself.
"""

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from agents.cli.reconstruct.pipeline import PipelineResult
from benchmarks.bounds import bounds_of
from benchmarks.scenes import (
    BINARY,
    BOARD,
    CLEAR,
    CROSSING,
    HIDDEN,
    NONE,
    OCCLUSION,
    REAL,
    SEGMENTED,
    SIM,
    TRUTH_SAMPLES,
    Run,
    Scene,
    StraightEdge,
)
from schemas.messages import SURE, RectifiedStereo, Status, ThreadReconstruction
from shared.arc_length import even_parameters
from shared.camera import project
from shared.curve_distance import curve_distance, distances_to_polyline, normal_errors, reprojection_px
from shared.splines import evaluate

REPROJECTION = ("left to mask", "mask to left", "right to mask", "mask to right")
NEAR_MASK = ("left mask near", "right mask near")
NEAR_PX = 3.0
PARALLEL, UNSEEN, REST = "row-parallel", "hidden", "other"
STRETCHES = (PARALLEL, UNSEEN, REST)
PARALLEL_DEG = 15.0
BELIEVED_PLACES = 400
OF_TRUTH = (
    "mean",
    "95 %",
    "max",
    "frechet",
    "end error",
    "length error",
    "mean seen",
    "in order",
    "crossings",
    "true crossings",
    "coverage",
    "nll",
)
OF_EDGE = ("straightness", "length share", "corners share", "length against corners")
OF_IMAGES = ("pixel bound", "bound", "bound seen", "centre noise px")


def figures(run: Run, result: PipelineResult) -> dict[str, Any]:
    """The row of one run."""
    scene, thread = run.scene, result.reconstruction
    row: dict[str, Any] = {
        "group": scene.group,
        "scene": scene.name,
        "masks": run.masks_are,
        "undecided": thread.course is not None and bool((thread.course.probability < SURE).any()),
        "calibration": run.calibration_is,
        "segmenter": result.observations.segmenter,
        "status": thread.status.name.lower(),
        "reason": thread.reason,
        "observations": len(result.observations.points_camera),
        "parallel": scene.edge is not None and scene.edge.slope_deg < PARALLEL_DEG,
        "published": scene.published,
        "ms": round(sum(result.timings_ms.values()), 1),
        "timings_ms": {step: round(ms, 2) for step, ms in result.timings_ms.items()},
    }
    row |= dict.fromkeys((*OF_TRUTH, *OF_IMAGES, *OF_EDGE, *REPROJECTION, *NEAR_MASK))
    if scene.truth is not None and scene.visible is not None and not run.calibration_is:
        row |= bounds_of(thread.camera, scene.truth, scene.visible, scene.images, run.masks)
    if scene.edge is not None:
        # the end corners alone have no part in any curve: this is what calibration and print leave to be expected
        row["corners share"] = scene.edge.corners_mm / scene.edge.length_mm - 1.0
    if thread.status is not Status.OK:
        return row
    curve = sampled(thread)
    if scene.truth is not None:
        truth = scene.truth if run.R_rectified_camera is None else scene.truth @ run.R_rectified_camera.T
        row |= against_truth(thread, curve, truth, scene.visible)
    if scene.edge is not None:
        row |= against_edge(curve, scene.edge)
    if scene.masks is not None and not run.calibration_is:
        row |= against_masks(thread.camera, curve, scene)
    return row


def sampled(thread: ThreadReconstruction) -> Float64[np.ndarray, "n 3"]:
    """Points evenly spaced along a reconstruction."""
    spline = thread.knots, thread.control_points_camera, thread.degree
    return evaluate(*spline, even_parameters(*spline, TRUTH_SAMPLES))


def against_truth(
    thread: ThreadReconstruction,
    curve: Float64[np.ndarray, "n 3"],
    truth: Float64[np.ndarray, "m 3"],
    visible: Bool[np.ndarray, "m 2"] | None,
) -> dict[str, Any]:
    """How far the curve lies from the true one, and whether its own word about that can be believed."""
    apart = curve_distance(curve, truth)
    curve_px, truth_px = project(thread.camera, curve)[0], project(thread.camera, truth)[0]
    order = topology(curve, truth, curve_px, truth_px)
    row: dict[str, Any] = {
        "mean": apart.mean,
        "95 %": apart.percentile_95,
        "max": apart.maximum,
        "frechet": apart.frechet,
        "end error": apart.ends,
        "length error": polyline_length(curve) - polyline_length(truth),
        "in order": order.in_order,
        "crossings": order.crossings,
        "true crossings": order.true_crossings,
    }
    if visible is None:
        visible = np.ones((len(truth), 2), bool)
    row["mean seen"] = mean_where(curve, truth, visible[:, 0] & visible[:, 1])
    if len(thread.posterior_s):
        row |= believed(thread, truth, stretch_of(truth_px, visible))
    return row


def mean_where(
    curve: Float64[np.ndarray, "n 3"], truth: Float64[np.ndarray, "m 3"], counts: Bool[np.ndarray, "m"]
) -> float | None:
    """The mean curve error over a part of the truth, None where that is empty."""
    if not counts.any():
        return None
    there = counts[np.asarray(KDTree(truth).query(curve)[1])]
    both = distances_to_polyline(truth, curve)[counts], distances_to_polyline(curve, truth)[there]
    return float(np.mean([d.mean() for d in both if len(d)]))


def stretch_of(truth_px: Float64[np.ndarray, "m 2"], visible: Bool[np.ndarray, "m 2"]) -> Int64[np.ndarray, "m"]:
    """The kind of stretch that each sample of the truth belongs to, as an index into STRETCHES.

    Hidden is what neither image shows; of the rest, parallel to the rows is what runs within 15° of them on the left.
    """
    along = np.gradient(truth_px, axis=0)
    slope = np.degrees(np.arctan2(np.abs(along[:, 1]), np.abs(along[:, 0])))
    kind = np.where(slope < PARALLEL_DEG, STRETCHES.index(PARALLEL), STRETCHES.index(REST))
    return np.where(visible.any(axis=1), kind, STRETCHES.index(UNSEEN)).astype(np.int64)


def believed(
    thread: ThreadReconstruction, truth: Float64[np.ndarray, "m 3"], stretch: Int64[np.ndarray, "m"]
) -> dict[str, Any]:
    """Places within the predicted 95 % ellipse and all places, by kind of stretch, and the mean NLL.

    Places are evenly spaced along the curve, wherever the method gave its covariances.
    """
    spline = thread.knots, thread.control_points_camera, thread.degree
    s = even_parameters(*spline, BELIEVED_PLACES)
    errors = normal_errors(evaluate(*spline, s), evaluate(*spline, s, 1), covariance_at(thread, s), truth)
    at = stretch[errors.nearest]
    counts = {
        kind: [int(errors.inside[at == index].sum()), int((at == index).sum())] for index, kind in enumerate(STRETCHES)
    }
    return {"coverage": counts, "nll": float(-errors.log_likelihood.mean())}


def covariance_at(thread: ThreadReconstruction, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3 3"]:
    """The posterior covariance at parameters between those that are told, entry by entry."""
    entries = thread.posterior_covariance.reshape(-1, 9).T
    return np.column_stack([np.interp(s, thread.posterior_s, entry) for entry in entries]).reshape(-1, 3, 3)


def against_masks(camera: RectifiedStereo, curve: Float64[np.ndarray, "n 3"], scene: Scene) -> dict[str, Any]:
    """Mean distances between the projected curve and the segmented pixels, and how many of these are near it."""
    assert scene.masks is not None
    row: dict[str, Any] = {}
    for eye, (pixels, mask) in enumerate(zip(project(camera, curve), scene.masks, strict=True)):
        both_ways = reprojection_px(pixels, mask >= SEGMENTED)
        for name, distances in zip(REPROJECTION[2 * eye : 2 * eye + 2], both_ways, strict=True):
            row[name] = float(distances.mean()) if len(distances) else None
        row[NEAR_MASK[eye]] = float((both_ways[1] <= NEAR_PX).mean()) if len(both_ways[1]) else None
    return row


def against_edge(curve: Float64[np.ndarray, "n 3"], edge: StraightEdge) -> dict[str, Any]:
    """How far the curve is from its best straight line, rms, and its length error as a share of the edge's length."""
    singular = np.linalg.svd(curve - curve.mean(axis=0), compute_uv=False)
    return {
        "straightness": float(np.sqrt(np.sum(singular[1:] ** 2) / len(curve))),
        "length share": polyline_length(curve) / edge.length_mm - 1.0,
        "length against corners": polyline_length(curve) / edge.corners_mm - 1.0,
    }


def polyline_length(points: Float64[np.ndarray, "n d"]) -> float:
    """The sum of the chords."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


SAMPLES = 400
NEXT_SAMPLES = 6
"""How far along the truth one step of the curve may lead without being a jump: one sample where all is well, more
where the curve cuts a corner."""
JUMP_PRICE = 0.2
"""Of a jump along the truth, as a share of its length: that of ten samples that are 2 % of the length off."""
LARGEST_BACK, LARGEST_SKIP = 0.03, 0.05
"""Of the thread's length: how far a curve in the right order may fall back or leave out."""
LEAST_LOOP = 0.01
"""Of the curve's length: a loop that is shorter is a kink, and no crossing."""


@dataclass(frozen=True)
class Topology:
    """The order of a curve along the true thread, and the crossings of either's picture."""

    in_order: bool
    crossings: int
    true_crossings: int

    @property
    def right(self) -> bool:
        """Whether the order is right and the crossings are as many as they should be."""
        return self.in_order and self.crossings == self.true_crossings


def topology(
    curve: Float64[np.ndarray, "n 3"],
    truth: Float64[np.ndarray, "m 3"],
    curve_px: Float64[np.ndarray, "n 2"],
    truth_px: Float64[np.ndarray, "m 2"],
) -> Topology:
    """Compare the topology of a curve with that of the true thread, both evenly sampled, in whichever direction fits.

    Args:
        curve_px, truth_px: their projections into the left image.
    """
    few, true = evenly(curve, SAMPLES), evenly(truth, SAMPLES)
    return Topology(
        in_order=_in_order(few, true) or _in_order(few[::-1], true),
        crossings=self_crossings(evenly(curve_px, SAMPLES)),
        true_crossings=self_crossings(evenly(truth_px, SAMPLES)),
    )


def _in_order(curve: Float64[np.ndarray, "n 3"], truth: Float64[np.ndarray, "n 3"]) -> bool:
    place = places_along(curve, truth) / (len(truth) - 1)
    ahead = np.maximum.accumulate(place)
    falls_back = float((ahead - place).max())
    reached = np.unique(np.concatenate(([0.0], place, [1.0])))
    return falls_back <= LARGEST_BACK and float(np.diff(reached).max()) <= LARGEST_SKIP


def places_along(curve: Float64[np.ndarray, "n d"], truth: Float64[np.ndarray, "m d"]) -> Int64[np.ndarray, "n"]:
    """For each sample of a curve the sample of the truth that it stands for: the nearest one, without needless jumps.

    The sequence of least summed distance, by dynamic programming: between samples of the curve the place may move by
    a few samples in either direction for nothing, and anywhere at the price of a jump.
    """
    distance = np.linalg.norm(curve[:, None] - truth[None], axis=2)
    price = JUMP_PRICE * float(np.linalg.norm(np.diff(truth, axis=0), axis=1).sum())
    shifts = np.arange(-NEXT_SAMPLES, NEXT_SAMPLES + 1)
    here = np.arange(len(truth))
    before = here[:, None] - shifts
    known = (before >= 0) & (before < len(truth))
    came_from = np.zeros(distance.shape, np.int64)
    cost = distance[0]
    for row in range(1, len(curve)):
        nearby = np.where(known, cost[np.clip(before, 0, len(truth) - 1)], np.inf)
        best = nearby.argmin(axis=1)
        jumped = int(cost.argmin())
        stay = nearby[here, best] <= cost[jumped] + price
        came_from[row] = np.where(stay, before[here, best], jumped)
        cost = distance[row] + np.where(stay, nearby[here, best], cost[jumped] + price)
    place = np.empty(len(curve), np.int64)
    place[-1] = cost.argmin()
    for row in range(len(curve) - 1, 0, -1):
        place[row - 1] = came_from[row, place[row]]
    return place


def self_crossings(px: Float64[np.ndarray, "n 2"]) -> int:
    """How often an evenly sampled polyline in the plane crosses itself, kinks apart."""
    start, along = px[:-1], np.diff(px, axis=0)
    count = len(start)

    def side(of: Float64[np.ndarray, "k 2"]) -> Float64[np.ndarray, "n k"]:
        """On which side of each piece points lie."""
        offset = of[None] - start[:, None]
        return along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]

    splits = (side(px[:-1]) > 0) != (side(px[1:]) > 0)
    i, j = np.nonzero(splits & splits.T)
    return int(np.count_nonzero(j - i > max(1.0, LEAST_LOOP * count)))


def evenly(points: Float64[np.ndarray, "n d"], count: int) -> Float64[np.ndarray, "k d"]:
    """About so many of the points, both ends among them."""
    return points[np.linspace(0, len(points) - 1, count).round().astype(int)]


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
