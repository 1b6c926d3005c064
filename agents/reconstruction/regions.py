"""Reliability regions: how far from each observation the thread may be (paper, section II-C).

In the image a region is as large as the segmented pixels around its observation. In depth it follows from how well
the depths nearby agree with a line (eq. 3): ε_z = 1.5 |L_j(t_j) − z_j|, with L_j the least-squares line through the
neighbouring depths over t, the length along the thread in the left image.

Where the text is silent: a bound is never below the standard deviation of its own line fit, since one observation may
lie on the line by luck; a bound of zero is replaced by the smallest other one.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from schemas.messages import RectifiedStereo
from shared.camera import project

NEIGHBOUR_SHARE = 0.1
"""Of the observations, to each side; half as many again on the one side that an end has."""
LEAST_NEIGHBOURS = 3
DEPTH_FACTOR = 1.5
LARGEST_DEPTH_SHARE = 0.5
"""Of its depth: a region must not reach the camera."""
LEAST_BOUND_PX = 1.0
"""At an image width of 640: a centroid is no better known than that."""


def image_bounds(half_size_px: Float64[np.ndarray, "n 2"], image_width: int) -> Float64[np.ndarray, "n 2"]:
    """Bounds (u, v) around each observation's left projection, no larger than the image."""
    return np.clip(half_size_px, LEAST_BOUND_PX * image_width / 640, image_width)


@dataclass(frozen=True)
class DepthFit:
    """Depth along the thread as lines through the neighbours of each observation see it.

    Fields:
        depth: L_j(t_j), the fitted depth at each observation; within its bound, hence before the camera.
        bound: ε_z of each observation.
    """

    depth: Float64[np.ndarray, "n"]
    bound: Float64[np.ndarray, "n"]


def fit_depth(points_camera: Float64[np.ndarray, "n 3"], camera: RectifiedStereo) -> DepthFit:
    """Fitted depths and bounds on depth of the ordered observations, in the unit of the points."""
    z = points_camera[:, 2]
    left_px, _ = project(camera, points_camera)
    t = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(left_px, axis=0), axis=1))))
    residual, spread = _line_fits(t, z, _neighbourhoods(len(z)))
    bound = np.maximum(DEPTH_FACTOR * np.abs(residual), spread)
    tiny = 1e-9 * z
    if (bound > tiny).any():
        bound = np.where(bound > tiny, bound, bound[bound > tiny].min())
    else:
        bound = half_pixel_depth(camera, z)
    bound = np.minimum(bound, LARGEST_DEPTH_SHARE * z)
    return DepthFit(z - np.clip(residual, -bound, bound), bound)


def half_pixel_depth(camera: RectifiedStereo, z: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """What half a pixel of disparity is in depth: where all depths agree, that is what they could not tell."""
    return 0.5 * z * (z / (camera.fx_px * camera.baseline))


def _neighbourhoods(count: int) -> Bool[np.ndarray, "n n"]:
    """Row j marks the neighbours of observation j, itself included."""
    reach = max(LEAST_NEIGHBOURS, round(NEIGHBOUR_SHARE * count))
    index = np.arange(count)
    low, high = index - reach, index + reach
    low = np.where(high > count - 1, np.minimum(low, count - 1 - (3 * reach) // 2), low)
    high = np.where(index - reach < 0, np.maximum(high, (3 * reach) // 2), high)
    return (index >= low[:, None]) & (index <= high[:, None])


def _line_fits(
    t: Float64[np.ndarray, "n"], z: Float64[np.ndarray, "n"], near: Bool[np.ndarray, "n n"]
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """How far each z lies above the line through its neighbourhood, and the standard deviation of that fit."""
    weight = near / near.sum(axis=1, keepdims=True)
    dt, dz = t - (weight @ t)[:, None], z - (weight @ z)[:, None]
    variance = (weight * dt**2).sum(axis=1)
    covariance = (weight * dt * dz).sum(axis=1)
    slope = np.divide(covariance, variance, out=np.zeros_like(variance), where=variance > 0)
    residual = dz - slope[:, None] * dt
    return np.diag(residual), np.sqrt((weight * residual**2).sum(axis=1))


def is_borrowed(count: int, gaps: Int64[np.ndarray, "g"]) -> Bool[np.ndarray, "n"]:
    """Which observations are ends of a connected stretch: perception puts them there at their neighbour's depth."""
    first = np.concatenate(([0], gaps + 1))
    last = np.append(gaps, count - 1)
    ends = np.zeros(count, bool)
    alone = first == last
    ends[first[~alone]] = ends[last[~alone]] = True
    return ends
