"""Every measure of one run as plain values, None where it cannot be had."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from agents.cli.reconstruct.pipeline import PipelineResult
from benchmarks.bounds import bounds_of
from benchmarks.scenes import TRUTH_SAMPLES, Scene, StraightEdge
from benchmarks.topology import topology
from benchmarks.variations import SEGMENTED, Run
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
