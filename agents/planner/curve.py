"""The thread as it is planned on: in metres, by arc length, where it is seen, and where strands lie side by side."""

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64

from schemas.messages import RectifiedStereo, Status, ThreadReconstruction
from shared.arc_length import length, parameters_at
from shared.camera import project
from shared.splines import evaluate

FARTHEST_M, SHORTEST_M, WIDEST_BASELINE_M = 1.0, 0.002, 0.2
"""No endoscope sees as far, nor has eyes as far apart, and nothing shorter can be grasped: then the unit is wrong."""
STRAND_POINTS = 400
LEAST_LOOP_M = 0.005
"""Thread between two strands of one place: less of it is a kink of the spline."""
FOLDED = 2.0
"""Two places are on different strands where the way along the thread is so many times the way through space. On a
straight thread both are equal, on a half circle the ratio is π / 2, and no depth error makes strands of neighbours."""


class NoGraspError(ValueError):
    """There can be no grasp, and the text says why."""


@dataclass(frozen=True)
class ThreadCurve:
    """A thread in metres, whatever the unit of its calibration."""

    camera: RectifiedStereo
    degree: int
    knots: Float64[np.ndarray, "k"]
    control_points_camera: Float64[np.ndarray, "m 3"]
    length_m: float
    unseen: Float64[np.ndarray, "g 2"]
    undecided: Float64[np.ndarray, "u 2"]
    _asked: dict[bytes, Float64[np.ndarray, "n"]] = field(default_factory=dict, compare=False, repr=False)

    def parameters(self, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
        """The spline's parameters at these shares of the arc length; the same shares are asked for again and again."""
        asked = s.tobytes()
        if asked not in self._asked:
            found = parameters_at(self.knots, self.control_points_camera, self.degree, s * self.length_m)
            found.flags.writeable = False
            self._asked[asked] = found
        return self._asked[asked]

    def points(self, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3"]:
        """Points at these shares of the arc length, in the camera frame."""
        return evaluate(self.knots, self.control_points_camera, self.degree, self.parameters(s))

    def tangents(self, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3"]:
        """Unit tangents towards the end of the thread; where the curve stops, that of the nearest s where it moves."""
        velocity = evaluate(self.knots, self.control_points_camera, self.degree, self.parameters(s), 1)
        speed = np.linalg.norm(velocity, axis=1)
        moving = np.flatnonzero(speed > 1e-9 * speed.max())
        if not len(moving):
            raise NoGraspError("the thread's curve has no direction anywhere")
        nearest = moving[np.argmin(np.abs(s[:, None] - s[moving]), axis=1)]
        return velocity[nearest] / speed[nearest, None]


def curve_of(thread: ThreadReconstruction) -> ThreadCurve:
    """The curve of a reconstruction, in metres.

    Raises:
        NoGraspError: where it failed, its unit is unknown, or its size is not that of a thread before an endoscope.
    """
    if thread.status is not Status.OK:
        raise NoGraspError(f"there is no thread: {thread.reason}")
    unit_m = thread.camera.metres_per_unit
    if unit_m is None:
        raise NoGraspError(
            "nobody knows the unit of the calibration, so nothing can be measured for a robot; give its metres_per_unit"
        )
    with np.errstate(all="ignore"):
        control_points = thread.control_points_camera * unit_m
        farthest_m = float(np.abs(control_points).max())
        if not farthest_m <= FARTHEST_M or not thread.camera.baseline * unit_m <= WIDEST_BASELINE_M:
            raise NoGraspError(
                f"the thread reaches {farthest_m:.3g} m from a camera whose eyes are "
                f"{thread.camera.baseline * unit_m:.3g} m apart; check the calibration's unit"
            )
        length_m = length(thread.knots, control_points, thread.degree)
    if not SHORTEST_M <= length_m < np.inf:
        raise NoGraspError(f"the thread is {1e3 * length_m:.3g} mm long, and cannot be grasped; check the unit")
    if thread.camera.baseline * unit_m == 0:
        raise NoGraspError("the eyes of the camera are 0 m apart; check the calibration's unit")
    undecided = np.empty((0, 2)) if thread.course is None else thread.course.undecided
    camera = dataclasses.replace(thread.camera, baseline=thread.camera.baseline * unit_m, metres_per_unit=1.0)
    unseen = np.sort(thread.unseen, axis=1)
    return ThreadCurve(camera, thread.degree, thread.knots, control_points, length_m, unseen, undecided)


def decided(curve: ThreadCurve, s: Float64[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Whether the thread is known to lead on at s, and not perhaps to another piece of itself.

    However short a stretch is, it lies at one place at least: each stands for what is nearest to it.
    """
    around = 0.5 * float(np.diff(s).max(initial=0.0))
    start, end = curve.undecided.T[:, :, None]
    return ~((s >= start - around) & (s <= end + around)).any(axis=0)


def seen(curve: ThreadCurve, s: Float64[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Whether both images show the thread at s: within their borders, and on no stretch that is known to be hidden."""
    # a stretch that reaches an end of the thread holds that end too
    start = np.where(curve.unseen[:, 0] <= 0, -1.0, curve.unseen[:, 0])
    end = np.where(curve.unseen[:, 1] >= 1, 2.0, curve.unseen[:, 1])
    hidden = np.asarray(((s[:, None] > start) & (s[:, None] < end)).any(axis=1))
    left_px, right_px = pixels(curve, curve.points(s))
    last = np.array([curve.camera.image_width, curve.camera.image_height]) - 0.5
    # comparisons with NaN, the pixel of what is behind the camera, are false
    within = [((px >= -0.5) & (px <= last)).all(axis=1) for px in (left_px, right_px)]
    return within[0] & within[1] & ~hidden


def pixels(
    curve: ThreadCurve, points_camera: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]:
    """Left and right pixels; NaN for points that are not in front of the camera."""
    with np.errstate(all="ignore"):
        left_px, right_px = project(curve.camera, points_camera)
    behind = ~(points_camera[:, 2:] > 0)
    return np.where(behind, np.nan, left_px), np.where(behind, np.nan, right_px)


def strand_distance(curve: ThreadCurve, s: Float64[np.ndarray, "n"], within_depth_m: float) -> Float64[np.ndarray, "n"]:
    """How far to the side of each place another strand of the thread passes, in metres; infinite where none does.

    Sideways is across the viewing ray, along which the jaws come: what lies there within `within_depth_m` before or
    behind is as good as there, since depth is what stereo knows least.
    """
    along = np.linspace(0.0, 1.0, STRAND_POINTS)
    depth, way_squared = _along_rays(curve.points(s), curve.points(along))
    sideways_squared = np.maximum(way_squared - depth**2, 0.0)
    arc = np.abs(s[:, None] - along) * curve.length_m
    other_strand = (arc**2 > np.maximum(FOLDED**2 * way_squared, LEAST_LOOP_M**2)) & (np.abs(depth) < within_depth_m)
    return np.sqrt(np.where(other_strand, sideways_squared, np.inf).min(axis=1))


def passing_distance(
    points: Float64[np.ndarray, "n 3"], others: Float64[np.ndarray, "m 3"], within_depth_m: float
) -> Float64[np.ndarray, "n"]:
    """How far to the side of each place the nearest of others lies, as `strand_distance` has it."""
    depth, way_squared = _along_rays(points, others)
    sideways_squared = np.maximum(way_squared - depth**2, 0.0)
    return np.sqrt(np.where(np.abs(depth) < within_depth_m, sideways_squared, np.inf).min(axis=1, initial=np.inf))


def _along_rays(
    points: Float64[np.ndarray, "n 3"], others: Float64[np.ndarray, "m 3"]
) -> tuple[Float64[np.ndarray, "n m"], Float64[np.ndarray, "n m"]]:
    """From each place to each other one: how much deeper along the viewing ray it lies, and how far away, squared."""
    rays = unit_vectors(points)
    x, y, z = (others[:, axis] - points[:, axis, None] for axis in range(3))
    depth = x * rays[:, 0, None] + y * rays[:, 1, None] + z * rays[:, 2, None]
    return depth, x**2 + y**2 + z**2


def unit_vectors(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
    """Vectors of length one; the z axis in place of a zero."""
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(norm > 0, vectors / np.where(norm > 0, norm, 1.0), np.array([0.0, 0.0, 1.0]))
