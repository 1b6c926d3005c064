"""Where on the thread a goal is, whichever way it was named."""

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, ThreadCurve, pixels
from agents.planner.needle import NeedleAround
from schemas.messages import GraspGoal

POLYLINE_POINTS = 1000


def goal_on_thread(
    goal: GraspGoal, curve: ThreadCurve, config: PlannerConfig, needle: NeedleAround | None = None
) -> float:
    """The place of a goal along the thread, as a share of its length.

    Raises:
        NoGraspError: where the goal is off the thread; the text says how far. Where it is told from the swage, and
            nobody knows where that is.
    """
    if goal.pixel is not None:
        return _nearest_to_pixel(curve, goal.pixel, config.goal_within_px)
    if goal.point_camera is not None:
        return _nearest_to_point(curve, goal.point_camera, config.goal_within_m)
    if goal.from_swage_m is not None:
        return _from_swage(curve, needle, goal.from_swage_m, config.goal_within_m)
    return goal.s or 0.0


def _nearest_to_pixel(curve: ThreadCurve, pixel: Float64[np.ndarray, "2"], within_px: float) -> float:
    projected, _ = pixels(curve, curve.points(_places()))
    place, off_px = nearest_on_polyline(projected, pixel)
    if off_px > within_px:
        raise NoGraspError(
            f"the goal at pixel ({pixel[0]:.0f}, {pixel[1]:.0f}) is {off_px:.0f} px off the thread, "
            f"and at most {within_px:.0f} px are accepted"
        )
    return _share(place)


def _nearest_to_point(curve: ThreadCurve, point_camera: Float64[np.ndarray, "3"], within_m: float) -> float:
    place, off_m = nearest_on_polyline(curve.points(_places()), point_camera)
    if off_m > within_m:
        raise NoGraspError(
            f"the goal point is {1e3 * off_m:.1f} mm off the thread, and at most {1e3 * within_m:.1f} mm are accepted"
        )
    return _share(place)


def _from_swage(curve: ThreadCurve, needle: NeedleAround | None, from_swage_m: float, within_m: float) -> float:
    """The place that so much thread lies before, counted from the swage.

    The curve may begin beyond the swage, and then the gap counts as thread; or run along a part of the needle that was
    taken for thread, and then that part does not.
    """
    if needle is None:
        raise NoGraspError("a goal from the swage needs the needle, and none is known where the thread was seen")
    if not needle.swage_seen:
        raise NoGraspError("a goal from the swage needs the swage in view of both eyes, and it is not")
    points = curve.points(_places())
    place, gap_m = nearest_on_polyline(points, needle.swage_camera)
    if gap_m > within_m:
        raise NoGraspError(
            f"the swage is {1e3 * gap_m:.1f} mm off the thread, and at most {1e3 * within_m:.1f} mm are accepted"
        )
    first = _share(place) < 0.5
    before = points[: int(place) + 1] if first else points[int(place) :]
    if float(needle.off(before).max()) > within_m:
        raise NoGraspError("thread leads away from the swage on both sides, so which one is meant cannot be told")
    at_end = place in (0, POLYLINE_POINTS - 1)
    along = (from_swage_m - (gap_m if at_end else 0.0)) / curve.length_m
    s = _share(place) + (along if first else -along)
    if along < 0 or not 0 <= s <= 1:
        seen_m = (curve.length_m * (1.0 - _share(place) if first else _share(place))) + (gap_m if at_end else 0.0)
        raise NoGraspError(
            f"thread is known from {1e3 * gap_m if at_end else 0.0:.1f} to {1e3 * seen_m:.1f} mm from the swage, and "
            f"the goal is at {1e3 * from_swage_m:.1f} mm"
        )
    return s


def _places() -> Float64[np.ndarray, "n"]:
    return np.linspace(0.0, 1.0, POLYLINE_POINTS)


def _share(place: float) -> float:
    return min(1.0, place / (POLYLINE_POINTS - 1))


def nearest_on_polyline(vertices: Float64[np.ndarray, "n d"], target: Float64[np.ndarray, "d"]) -> tuple[float, float]:
    """Where a polyline comes nearest to a point: index of the vertex before, with the fraction beyond; and how near.

    Segments with a NaN are left out; the distance is infinite where none remains.
    """
    with np.errstate(all="ignore"):
        start, step = vertices[:-1], np.diff(vertices, axis=0)
        squared = (step**2).sum(axis=1)
        fraction = np.clip(((target - start) * step).sum(axis=1) / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
        distance = np.linalg.norm(start + fraction[:, None] * step - target, axis=1)
    distance = np.where(np.isnan(distance), np.inf, distance)
    i = int(np.argmin(distance))
    return i + float(fraction[i]) if np.isfinite(distance[i]) else 0.0, float(distance[i])
