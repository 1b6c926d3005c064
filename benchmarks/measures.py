"""Every measure of one run as plain values, None where it cannot be had.

Topology: whether a curve visits the places of the true thread in their order, and how often its picture crosses itself.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from agents.cli.reconstruct.pipeline import Pair, PipelineResult
from benchmarks.bounds import bounds_of
from benchmarks.scenes import SEGMENTED, TRUTH_SAMPLES, Run, TrueThread
from benchmarks.tables import Row
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
OF_TRUTH = ("mean", "frechet", "mean seen", "in order", "crossings", "true crossings", "coverage")
OF_IMAGES = ("pixel bound", "bound", "bound seen")
MEASURES = (*OF_TRUTH, *OF_IMAGES, *REPROJECTION, *NEAR_MASK)


def figures(run: Run, result: PipelineResult) -> Row:
    """The row of one run."""
    scene, thread = run.scene, result.reconstruction
    row: Row = {
        "group": scene.group,
        "scene": scene.name,
        "masks": run.masks_are,
        "undecided": thread.course is not None and bool((thread.course.probability < SURE).any()),
        "calibration": run.calibration_is,
        "segmenter": result.observations.segmenter,
        "status": thread.status.name.lower(),
        "reason": thread.reason,
        "timings_ms": {step: round(ms, 2) for step, ms in result.timings_ms.items()},
    }
    row |= dict.fromkeys(MEASURES)
    if scene.threads and not run.calibration_is:
        row |= bounds_of(thread.camera, scene.threads[0], scene.images, run.masks)
    if thread.status is not Status.OK:
        return row
    curve = sampled(thread)
    if scene.threads:
        row |= against_truth(thread, curve, scene.threads[0], run.R_rectified_camera)
    if scene.masks is not None and not run.calibration_is:
        row |= against_masks(thread.camera, curve, scene.masks)
    return row


def sampled(thread: ThreadReconstruction) -> Float64[np.ndarray, "n 3"]:
    """Points evenly spaced along a reconstruction."""
    spline = thread.knots, thread.control_points_camera, thread.degree
    return evaluate(*spline, even_parameters(*spline, TRUTH_SAMPLES))


def against_truth(
    thread: ThreadReconstruction,
    curve: Float64[np.ndarray, "n 3"],
    true: TrueThread,
    R_rectified_camera: Float64[np.ndarray, "3 3"] | None,
) -> Row:
    """How far the curve lies from the true one, and whether its own word about that can be believed."""
    truth = true.points if R_rectified_camera is None else true.points @ R_rectified_camera.T
    apart = curve_distance(curve, truth)
    curve_px, truth_px = project(thread.camera, curve)[0], project(thread.camera, truth)[0]
    row: Row = {
        "mean": apart.mean,
        "frechet": apart.frechet,
        "mean seen": mean_where(curve, truth, true.visible[:, 0] & true.visible[:, 1]),
        **topology(curve, truth, curve_px, truth_px),
    }
    if len(thread.posterior_s):
        row["coverage"] = covered(thread, truth, stretch_of(truth_px, true.visible))
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


def covered(
    thread: ThreadReconstruction, truth: Float64[np.ndarray, "m 3"], stretch: Int64[np.ndarray, "m"]
) -> dict[str, list[int]]:
    """Places within the predicted 95 % ellipse and all places, by kind of stretch.

    Places are evenly spaced along the curve, wherever the method gave its covariances.
    """
    spline = thread.knots, thread.control_points_camera, thread.degree
    s = even_parameters(*spline, BELIEVED_PLACES)
    errors = normal_errors(evaluate(*spline, s), evaluate(*spline, s, 1), covariance_at(thread, s), truth)
    at = stretch[errors.nearest]
    return {
        kind: [int(errors.inside[at == index].sum()), int((at == index).sum())] for index, kind in enumerate(STRETCHES)
    }


def coverage_of(row: Row) -> tuple[int, int]:
    """Places of all stretches within their ellipse, and places; zeros where none is predicted."""
    inside, places = np.sum(list(row["coverage"].values()), axis=0) if row["coverage"] else (0, 0)
    return int(inside), int(places)


def covariance_at(thread: ThreadReconstruction, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3 3"]:
    """The posterior covariance at parameters between those that are told, entry by entry."""
    entries = thread.posterior_covariance.reshape(-1, 9).T
    return np.column_stack([np.interp(s, thread.posterior_s, entry) for entry in entries]).reshape(-1, 3, 3)


def against_masks(camera: RectifiedStereo, curve: Float64[np.ndarray, "n 3"], masks: Pair) -> Row:
    """Mean distances between the projected curve and the segmented pixels, and how many of these are near it."""
    row: Row = {}
    for eye, (pixels, mask) in enumerate(zip(project(camera, curve), masks, strict=True)):
        both_ways = reprojection_px(pixels, mask >= SEGMENTED)
        for name, distances in zip(REPROJECTION[2 * eye : 2 * eye + 2], both_ways, strict=True):
            row[name] = float(distances.mean()) if len(distances) else None
        row[NEAR_MASK[eye]] = float((both_ways[1] <= NEAR_PX).mean()) if len(both_ways[1]) else None
    return row


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


def topology(
    curve: Float64[np.ndarray, "n 3"],
    truth: Float64[np.ndarray, "m 3"],
    curve_px: Float64[np.ndarray, "n 2"],
    truth_px: Float64[np.ndarray, "m 2"],
) -> dict[str, Any]:
    """The order of a curve along the true thread, in whichever direction fits, and the crossings of either's picture.

    Args:
        curve, truth: evenly sampled; `curve_px`, `truth_px` their projections into the left image.
    """
    few, true = evenly(curve, SAMPLES), evenly(truth, SAMPLES)
    return {
        "in order": _in_order(few, true) or _in_order(few[::-1], true),
        "crossings": self_crossings(evenly(curve_px, SAMPLES)),
        "true crossings": self_crossings(evenly(truth_px, SAMPLES)),
    }


def topology_is_right(row: Row) -> bool:
    """Whether a run has the thread's order, and as many crossings as it should."""
    return bool(row["in order"]) and row["crossings"] == row["true crossings"]


def topology_of(row: Row) -> str:
    """Right, or which of the order and the crossings is wrong; empty where that is unknown."""
    if row["in order"] is None:
        return ""
    if topology_is_right(row):
        return "right"
    return f"{'order right' if row['in order'] else 'order wrong'}, {row['crossings']} of {row['true crossings']} X"


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
