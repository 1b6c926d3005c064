"""Hand-eye calibration from sightings of one point of a moving tool, with the delay between camera and joints.

A point o of the tool, seen at time t of the camera's clock as m, was where the robot was measured at t - δ:

    m = π( X (R(t - δ) o + p(t - δ)) ) + noise,      X = T_camera_base

with π the projection into both rectified images (or the identity, where points were measured). Unknown are X, δ, and o
where it is not told. For each δ of a grid the rigid fit of triangulated to measured points (Kabsch, Acta Cryst. A32,
1976, weighted anew against outliers) gives X; from the best, Gauss-Newton's steps as Levenberg and Marquardt damp them
lead to the least robust sum of squares over all unknowns (soft l1; scipy's least_squares). A sighting more than
OUTLIER deviations off is left out and named. Covariance is s² (JᵀJ)⁻¹ of what is left.

Sightings and poses each have times of their own clock. A place is two pixels of a rectified pair, or a point before the
camera. Lengths are metres.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import least_squares

from schemas.messages import RectifiedStereo
from shared.calibration.stated import CalibrationError
from shared.rigid_transforms import apply, exp_se3, nearest_rotation, transform


@dataclass(frozen=True, eq=False)
class Sightings:
    """What the camera saw of one point of the tool.

    Fields:
        seen: of n moments, (u, v) in the left and (u, v) in the right image; or (x, y, z) in the camera's frame.
        camera: in metres, that the pixels are of; None where points were seen.
    """

    time_s: Float64[np.ndarray, "n"]
    seen: Float64[np.ndarray, "n d"]
    camera: RectifiedStereo | None

    @property
    def points_camera(self) -> Float64[np.ndarray, "n 3"]:
        """Where each was; of pixels by the disparity, the rows' mean giving y."""
        if self.camera is None:
            return self.seen
        u_left, v_left, u_right, v_right = self.seen.T
        camera = self.camera
        z = camera.fx_px * camera.baseline / np.maximum(u_left - u_right, 1e-3)
        x = (u_left - camera.cx_px) * z / camera.fx_px
        return np.column_stack((x, (0.5 * (v_left + v_right) - camera.cy_px) * z / camera.fy_px, z))

    def predicted(self, points_camera: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n d"]:
        """What the camera would see of points: as `seen`."""
        camera = self.camera
        if camera is None:
            return points_camera
        x, y, z = points_camera.T
        z = np.maximum(z, 1e-3)
        u, v = camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px
        return np.column_stack((u, v, u - camera.fx_px * camera.baseline / z, v))

    def only(self, kept: np.ndarray) -> "Sightings":
        """Some of them."""
        return Sightings(self.time_s[kept], self.seen[kept], self.camera)


@dataclass(frozen=True, eq=False)
class Motion:
    """The tool's poses in the base's frame, their times increasing."""

    time_s: Float64[np.ndarray, "m"]
    T_base_tool: Float64[np.ndarray, "m 4 4"]

    def at(self, time_s: Float64[np.ndarray, "n"], point_tool: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "n 3"]:
        """Where a point of the tool was in the base's frame, between two poses on the straight line."""
        points = self.T_base_tool[:, :3, :3] @ point_tool + self.T_base_tool[:, :3, 3]
        return np.column_stack([np.interp(time_s, self.time_s, axis) for axis in points.T])


_IRLS = 8


@dataclass(frozen=True, eq=False)
class Fit:
    """Unknowns with the Jacobian of the plain residuals; X = exp(twist) X0."""

    X: Float64[np.ndarray, "4 4"]
    delay_s: float
    point: Float64[np.ndarray, "3"]
    residual: Float64[np.ndarray, "n d"]
    J: Float64[np.ndarray, "r p"]


def rigid_fit(
    points_base: Float64[np.ndarray, "n 3"], points_camera: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "4 4"]:
    """The rigid transform of the least sum of distances, as least squares that are weighted anew."""
    found = _weighted_fit(points_base, points_camera, np.ones(len(points_base)))
    for _ in range(_IRLS):
        apart = np.linalg.norm(apply(found, points_base) - points_camera, axis=1)
        weight = 1 / np.maximum(apart, max(1e-6, 0.5 * float(np.median(apart))))
        found = _weighted_fit(points_base, points_camera, weight)
    return found


def _weighted_fit(
    points_base: Float64[np.ndarray, "n 3"], points_camera: Float64[np.ndarray, "n 3"], weight: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "4 4"]:
    share = weight / weight.sum()
    a, b = share @ points_base, share @ points_camera
    R = nearest_rotation((points_camera - b).T @ (share[:, None] * (points_base - a)))
    return transform(R, b - R @ a)


def fitted(
    sightings: Sightings,
    motion: Motion,
    X0: Float64[np.ndarray, "4 4"],
    delay_s: float,
    point: Float64[np.ndarray, "3"],
    point_known: bool,
    delay_free: bool,
) -> Fit:
    """The unknowns of the least robust sum; the twist is in metres and tenths of a radian, times in tenths of a second.

    The scale of the robust loss is what the residuals' median absolute deviation makes of it, found twice.
    """
    scale = np.concatenate(
        (np.ones(3), np.full(3, 0.1), [0.1 if delay_free else 0.0], np.full(3, 0.0 if point_known else 1.0))
    )
    free = np.flatnonzero(scale)

    def unknowns(x: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        full = np.zeros(10)
        full[free] = x * scale[free]
        return exp_se3(full[:6]) @ X0, delay_s + float(full[6]), point + full[7:]

    def residual(x: np.ndarray) -> np.ndarray:
        X, delay, o = unknowns(x)
        return sightings.predicted(apply(X, motion.at(sightings.time_s - delay, o))) - sightings.seen

    x, spread = np.zeros(len(free)), deviation(residual(np.zeros(len(free))))
    for _ in range(2):
        solved = least_squares(lambda x, s=spread: residual(x).ravel() / s, x, loss="soft_l1", x_scale=1e-3)
        x, spread = solved.x, deviation(residual(solved.x))
    X, delay, o = unknowns(x)
    J = np.zeros((sightings.seen.size, 10))
    J[:, free] = np.stack([_slope(residual, x, i) for i in range(len(free))], axis=1) / scale[free]
    return Fit(X, delay, o, residual(x), J)


def _slope(residual: Callable[[np.ndarray], np.ndarray], x: np.ndarray, i: int) -> np.ndarray:
    """One column of the Jacobian, by central differences."""
    step = np.zeros(len(x))
    step[i] = 1e-5
    return (residual(x + step) - residual(x - step)).ravel() / 2e-5


def deviation(residual: np.ndarray) -> float:
    """Of normal residuals, by the median of their sizes."""
    return max(1.4826 * float(np.median(np.abs(residual))), 1e-9)


def covariance(fit: Fit) -> Float64[np.ndarray, "10 10"]:
    """Of twist, delay and point; unknowns that were not free have none."""
    free = np.flatnonzero(np.abs(fit.J).max(axis=0) > 0)
    J, values = fit.J[:, free], fit.residual.ravel()
    s2 = float(values @ values) / max(len(values) - len(free), 1)
    # unknowns differ in size by orders of magnitude, which must not look like one that cannot be told
    size = np.linalg.norm(J, axis=0)
    C = np.zeros((10, 10))
    C[np.ix_(free, free)] = s2 * np.linalg.pinv((J / size).T @ (J / size)) / np.outer(size, size)
    if 6 not in free:
        C[6, 6] = np.inf
    return C


LEAST = 12
"""Sightings; with fewer, what is held out says nothing."""
LARGEST_DELAY_S, DELAY_STEP_S = 0.5, 0.02
DELAY_TOLD_S = 0.02
"""A delay whose deviation is larger is not told: the tool hardly moved."""
SPREAD_M = 0.004
"""How far (root mean square) places must spread in the second of their directions, for the rotation to be known."""
OUTLIER = 4.0
LARGEST_SHARE_OUT = 0.3
LARGEST_SHARE_LEFT = 0.2
"""Of the spread of places: where more than that is left over, poses and sightings have nothing in common."""
FOLDS = 5


@dataclass(frozen=True, eq=False)
class Estimate:
    """A hand-eye calibration and what it is worth.

    Fields:
        delay_s: by how much the camera's stamps are later than the joints' (None where it is not told).
        delay_deviation_s: its standard deviation.
        point_tool: the point of the tool that was seen.
        covariance: 6x6, of the twist (v, ω) that multiplies T_camera_base from the left.
        residual: of each sighting that was used, in pixels (root mean square over both images), or in metres.
        residual_m: the same as a distance between points.
        used: which sightings were.
        held_out, held_out_m: the same two where a fifth of the time at a time was left out of the estimate.
    """

    T_camera_base: Float64[np.ndarray, "4 4"]
    delay_s: float | None
    delay_deviation_s: float
    point_tool: Float64[np.ndarray, "3"]
    covariance: Float64[np.ndarray, "6 6"]
    residual: Float64[np.ndarray, "k"]
    residual_m: Float64[np.ndarray, "k"]
    used: Bool[np.ndarray, "n"]
    held_out: Float64[np.ndarray, "k"]
    held_out_m: Float64[np.ndarray, "k"]

    def deviation_m(self, point_camera: Float64[np.ndarray, "3"]) -> float:
        """By how much (root mean square) a point there may be off, as far as noise alone goes."""
        x, y, z = point_camera
        J = np.hstack((np.eye(3), np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])))
        return float(np.sqrt(np.trace(J @ self.covariance @ J.T)))


def estimated(
    sightings: Sightings, motion: Motion, point_tool: Float64[np.ndarray, "3"], point_known: bool = True
) -> Estimate:
    """The calibration, from all sightings whose time the robot's poses cover.

    Raises:
        CalibrationError: where there is too little, or it says nothing of the rotation, or contradicts itself.
    """
    covered = _covered(sightings, motion)
    index = np.flatnonzero(covered)
    sightings = sightings.only(covered)
    _check_spread(sightings.points_camera, "the sightings lie")
    _check_spread(motion.at(sightings.time_s, point_tool), "the robot's poses lie")
    delay, begun = _begun(sightings, motion, point_tool)
    fit = fitted(sightings, motion, begun, delay, point_tool, point_known, True)
    kept = _consistent(fit.residual)
    if kept.mean() < 1 - LARGEST_SHARE_OUT:
        raise CalibrationError(
            f"{1 - kept.mean():.0%} of the sightings contradict the rest: is it the same point of the tool, seen at "
            "the time that is told, and in the calibration's images?"
        )
    fit = fitted(sightings.only(kept), motion, fit.X, fit.delay_s, fit.point, point_known, True)
    delay_deviation_s = float(np.sqrt(covariance(fit)[6, 6]))
    told = delay_deviation_s <= DELAY_TOLD_S
    if not told:
        fit = fitted(sightings.only(kept), motion, fit.X, 0.0, fit.point, point_known, False)
    if deviation(fit.residual) > LARGEST_SHARE_LEFT * _spread(sightings.seen)[1]:
        raise CalibrationError(
            "sightings and poses do not move alike: is it this arm's tool, and are both times of one clock, in seconds?"
        )
    used = np.zeros(len(covered), dtype=bool)
    used[index[kept]] = True
    final = sightings.only(kept)
    residual, apart = _left(final, motion, fit)
    return Estimate(
        fit.X,
        fit.delay_s if told else None,
        delay_deviation_s,
        fit.point,
        covariance(fit)[:6, :6],
        residual,
        apart,
        used,
        *_held_out(final, motion, fit, point_known, told),
    )


def _covered(sightings: Sightings, motion: Motion) -> Bool[np.ndarray, "n"]:
    margin = LARGEST_DELAY_S if motion.time_s[-1] - motion.time_s[0] > 4 * LARGEST_DELAY_S else 0.0
    lower, upper = motion.time_s[0] + margin, motion.time_s[-1] - margin
    covered = (sightings.time_s >= lower) & (sightings.time_s <= upper)
    if covered.sum() < LEAST:
        raise CalibrationError(
            f"{covered.sum()} of {len(covered)} sightings lie within the time of the robot's poses, and {LEAST} are "
            "needed: record both together, by one clock, and the poses half a second longer at both ends"
        )
    return covered


def _check_spread(points: Float64[np.ndarray, "n 3"], which: str) -> None:
    if (across_m := _spread(points)[1]) < SPREAD_M:
        raise CalibrationError(
            f"{which} within {1e3 * across_m:.1f} mm of one line, so that the rotation about it cannot be known: move "
            "the tool some centimetres to all sides, and in depth"
        )


def _spread(values: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "d"]:
    """How far (root mean square) values spread in each of their principal directions, the farthest first."""
    return np.linalg.svd(values - np.median(values, axis=0), compute_uv=False) / np.sqrt(len(values))


def _begun(sightings: Sightings, motion: Motion, point: Float64[np.ndarray, "3"]) -> tuple[float, np.ndarray]:
    """The delay of a grid at which a rigid transform fits best, and that transform; the least delay of equals."""
    seen = sightings.points_camera
    delays = np.arange(-LARGEST_DELAY_S, LARGEST_DELAY_S + DELAY_STEP_S / 2, DELAY_STEP_S)
    found = []
    for delay in sorted(delays, key=abs):
        at = motion.at(sightings.time_s - delay, point)
        fit = rigid_fit(at, seen)
        found.append((float(np.median(np.linalg.norm(apply(fit, at) - seen, axis=1))), float(delay), fit))
    _, delay, best = min(found, key=lambda one: one[0])
    return delay, best


def _left(sightings: Sightings, motion: Motion, fit: Fit) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """What is left of each sighting: in pixels (root mean square over both images) or metres, and in metres."""
    points = apply(fit.X, motion.at(sightings.time_s - fit.delay_s, fit.point))
    apart = np.linalg.norm(sightings.points_camera - points, axis=1)
    if sightings.camera is None:
        return apart, apart
    return np.sqrt(((sightings.predicted(points) - sightings.seen) ** 2).mean(axis=1)), apart


def _consistent(residual: Float64[np.ndarray, "n d"]) -> Bool[np.ndarray, "n"]:
    return np.abs(residual).max(axis=1) <= OUTLIER * np.maximum(deviation(residual), 1e-9)


def _held_out(
    sightings: Sightings, motion: Motion, fit: Fit, point_known: bool, delay_free: bool
) -> tuple[Float64[np.ndarray, "k"], Float64[np.ndarray, "k"]]:
    """What is left of sightings in an estimate without them, stretch of time by stretch."""
    order = np.argsort(sightings.time_s)
    left = []
    for out in np.array_split(order, FOLDS):
        rest = np.setdiff1d(order, out)
        without = fitted(sightings.only(rest), motion, fit.X, fit.delay_s, fit.point, point_known, delay_free)
        left.append(_left(sightings.only(out), motion, without))
    return np.concatenate([one for one, _ in left]), np.concatenate([apart for _, apart in left])
