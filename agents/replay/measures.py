"""What two results say differently, whatever they are described with: curves, outlines, ways of a tool.

Two splines of one curve may have other control points, and two runs of one algorithm other numbers of points. So these
measure what the numbers stand for. Lengths are in millimetres; where nobody knows the calibration's unit, in such that
what is seen lies 100 mm away.
"""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float64

from agents.replay.compare import OTHER
from schemas.messages import (
    Crossing,
    GraspPlan,
    Image,
    Judgement,
    Over,
    Phase,
    RectifiedStereo,
    ThreadObservations,
    ThreadReconstruction,
    TissueSurface,
    Waypoint,
)
from shared.curve_distance import distances_to_polyline, nearest_distances
from shared.images import ImageDataError, decode_image
from shared.splines import evaluate

SAMPLES = 200
MM_PER_METRE = 1000.0
TYPICAL_MM = 100.0
MOST = 95
"""The percentile of distances between centrelines: one pixel of a mask may make a spur, or take one away."""

Polyline = Float64[np.ndarray, "n d"]


def told(field: str, name: str) -> Callable[[Any], str]:
    """What tells in words how many of something a message holds."""
    return lambda message: f"{len(getattr(message, field)) or 'no'} {name}"


def phases_told(plan: GraspPlan) -> str:
    """The phases that a plan has."""
    return ", ".join(phase.name.lower() for phase in _begins(plan.waypoints)) or "no phases"


def cells_told(surface: TissueSurface) -> str:
    """How much of the tissue is known."""
    return f"{int(surface.valid.sum())} of {surface.valid.size} cells known"


def curves_apart_mm(then: ThreadReconstruction, now: ThreadReconstruction) -> float:
    """The largest distance from a place of one curve to the other."""
    a, b = (_sampled(thread) for thread in (then, now))
    return _scale(then.camera, a) * polylines_apart(a, b)


def ends_apart_mm(then: ThreadReconstruction, now: ThreadReconstruction) -> float:
    """The larger distance between ends that have the same s: large too where the direction is another."""
    if not len(then.control_points_camera) or not len(now.control_points_camera):
        return 0.0 if then.status is now.status else OTHER
    a, b = (thread.control_points_camera[[0, -1]] for thread in (then, now))
    return _scale(then.camera, then.control_points_camera) * float(np.linalg.norm(a - b, axis=1).max())


def points_apart_mm(then: ThreadObservations, now: ThreadObservations) -> float:
    """The largest distance from an observation to the line through the other observations."""
    scale = _scale(then.camera, then.points_camera)
    return scale * polylines_apart(then.points_camera, now.points_camera)


def deviation_apart_mm(then: ThreadReconstruction, now: ThreadReconstruction) -> float:
    """The largest difference of the predicted standard deviation at the same s."""
    a, b = (np.sqrt(np.trace(t.posterior_covariance, axis1=1, axis2=2).clip(0.0)) for t in (then, now))
    scale = _scale(then.camera, then.control_points_camera)
    return scale * profiles_apart(then.posterior_s, a, now.posterior_s, b)


def confidence_apart(then: ThreadReconstruction, now: ThreadReconstruction) -> float:
    """The largest difference of confidence at the same s."""
    return profiles_apart(then.confidence_s, then.confidence, now.confidence_s, now.confidence)


def depths_apart_mm(then: TissueSurface, now: TissueSurface) -> float:
    """The median difference of depth where both know it."""
    if then.depth.shape != now.depth.shape:
        return OTHER
    both = then.valid & now.valid
    if not both.any():
        return 0.0 if then.valid.any() == now.valid.any() else OTHER
    scale = _scale(then.camera, then.depth[then.valid][:, None])
    return scale * float(np.median(np.abs(then.depth - now.depth)[both]))


def tool_paths_apart_mm(then: GraspPlan, now: GraspPlan) -> float:
    """The largest distance from a place of one way of the tool to the other."""
    a, b = (np.array([w.T_camera_tool[:3, 3] for w in plan.waypoints]).reshape(-1, 3) for plan in (then, now))
    return MM_PER_METRE * polylines_apart(a, b)


def tool_turned_deg(then: GraspPlan, now: GraspPlan) -> float:
    """The largest angle between the tools where a phase begins."""
    a, b = (_begins(plan.waypoints) for plan in (then, now))
    if a.keys() != b.keys():
        return OTHER
    cosine = [(np.trace(a[phase].T @ b[phase]) - 1.0) / 2.0 for phase in a]
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max(initial=0.0))


def polylines_apart(a: Polyline, b: Polyline) -> float:
    """The largest distance from a corner of one polyline to the other, either way; 0 where there is neither."""
    if len(a) == 0 or len(b) == 0:
        return 0.0 if len(a) == len(b) else OTHER
    return float(max(distances_to_polyline(a, b).max(), distances_to_polyline(b, a).max()))


def most_apart(a: Polyline, b: Polyline) -> float:
    """What 95 % of the points of either set are within of the other."""
    if len(a) == 0 or len(b) == 0:
        return 0.0 if len(a) == len(b) else OTHER
    return float(max(np.percentile(nearest_distances(x, y), MOST) for x, y in ((a, b), (b, a))))


def profiles_apart(
    s: Float64[np.ndarray, "n"], value: Float64[np.ndarray, "n"],
    other_s: Float64[np.ndarray, "m"], other: Float64[np.ndarray, "m"],
) -> float:  # fmt: skip
    """The largest difference of two functions of s, each given at places of its own."""
    if len(s) == 0 or len(other_s) == 0:
        return 0.0 if len(s) == len(other_s) else OTHER
    at = np.linspace(0.0, 1.0, SAMPLES)
    return float(np.abs(np.interp(at, s, value) - np.interp(at, other_s, other)).max())


def images_apart(then: Image | None, now: Image | None) -> float:
    """The mean difference of the pixels, as a share of black to white."""
    if then is None or now is None:
        return 0.0 if then is now else OTHER
    try:
        a, b = decode_image(then), decode_image(now)
    except ImageDataError:
        return 0.0 if then == now else OTHER
    return OTHER if a.shape != b.shape else float(np.abs(a.astype(np.int16) - b).mean() / 255.0)


def stretches_apart(then: Float64[np.ndarray, "g 2"] | None, now: Float64[np.ndarray, "g 2"] | None) -> float:
    """The difference of the summed lengths of stretches."""
    if then is None or now is None:
        return 0.0 if then is now else OTHER
    return abs(float(np.diff(then).sum() - np.diff(now).sum()))


def crossings_apart(then: tuple[Crossing, ...], now: tuple[Crossing, ...]) -> float:
    """The largest difference of where the crossings lie along the thread; OTHER where another strand is above.

    What one of both leaves undetermined contradicts nothing.
    """
    over = [{c.over for c in pair} - {Over.UNDETERMINED} for pair in zip(then, now, strict=False)]
    if len(then) != len(now) or any(len(said) > 1 for said in over):
        return OTHER
    a, b = (np.array([(c.s_first, c.s_second) for c in crossings]) for crossings in (then, now))
    return float(np.abs(a - b).max(initial=0.0))


def findings_apart(then: tuple[Judgement, ...], now: tuple[Judgement, ...]) -> float:
    """Whether the same was found, whatever figures the sentences name."""
    a, b = ({(j.code, j.severity) for j in judgements} for judgements in (then, now))
    return 0.0 if a == b else OTHER


def same_or_other(then: Any, now: Any) -> float:
    """Of digests, whose difference is no amount."""
    return 0.0 if then == now else OTHER


def words_apart(then: str, now: str) -> float:
    """Whether two sentences are the same but for their figures."""
    a, b = (re.sub(r"[\d.]+", "0", text) for text in (then, now))
    return 0.0 if a == b else OTHER


def counts_apart(then: tuple[object, ...] | np.ndarray, now: tuple[object, ...] | np.ndarray) -> float:
    """How many more there are of one."""
    return float(abs(len(then) - len(now)))


def medians_apart(then: Float64[np.ndarray, "n"], now: Float64[np.ndarray, "m"]) -> float:
    """The difference of two medians."""
    if len(then) == 0 or len(now) == 0:
        return 0.0 if len(then) == len(now) else OTHER
    return abs(float(np.median(then) - np.median(now)))


def relative(then: float, now: float) -> float:
    """The difference of two numbers as a share of the larger."""
    return abs(then - now) / max(abs(then), abs(now), 1e-12)


def metres_in_mm(then: float | None, now: float | None) -> float:
    """The difference of two lengths, of which there may be none."""
    if then is None or now is None:
        return 0.0 if then is now else OTHER
    return MM_PER_METRE * abs(then - now)


def _sampled(thread: ThreadReconstruction) -> Polyline:
    if not len(thread.control_points_camera):
        return np.zeros((0, 3))
    at = np.linspace(0.0, 1.0, SAMPLES)
    return evaluate(thread.knots, thread.control_points_camera, thread.degree, at)


def _begins(waypoints: tuple[Waypoint, ...]) -> dict[Phase, Float64[np.ndarray, "3 3"]]:
    """The orientation of the tool at the first waypoint of each phase."""
    return {w.phase: w.T_camera_tool[:3, :3] for w in reversed(waypoints)}


def _scale(camera: RectifiedStereo, seen: Polyline) -> float:
    """Millimetres per unit, or what brings the median depth of what is seen to a typical one."""
    if camera.metres_per_unit is not None:
        return MM_PER_METRE * camera.metres_per_unit
    return TYPICAL_MM / float(np.median(seen[:, -1])) if len(seen) else 1.0
