"""Unknowns of a hand-eye calibration that leave the least robust sum of squares, and a rigid fit to begin them with.

The equation and what is unknown are estimate.py's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares

from shared.calibration.hand_eye.samples import Motion, Sightings
from shared.rigid_transforms import apply, exp_se3, nearest_rotation, transform

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
