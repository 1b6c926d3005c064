"""The first curve: course in the left image and disparity as smooth functions of the length along it, robustly."""

import numpy as np
import scipy.linalg
from jaxtyping import Float64

from agents.reconstruction.refined.alignment import Alignment
from agents.reconstruction.refined.chains import Chain
from agents.reconstruction.refined.projection import DEGREE, Curve, at_constant_speed, fitted
from schemas.messages import RectifiedStereo
from shared.camera import backproject, depth_of_disparity
from shared.splines import basis_matrix, clamped_uniform_knots, difference_matrix

ROUNDS = 5
SPAN_SHARE = 0.0167
"""Of the image's width: what one span of the spline covers at least, some widths of thread."""
FEWEST, MOST = 12, 70
IMAGE_SMOOTHING, DISPARITY_SMOOTHING = 1e-3, 1e-1
ROBUST = 2.5
LEAST_DISPARITY_PX = 0.3
EXTRAPOLATION = 0.3
"""Of the range of matched disparities: how far a curve may leave it where nothing is matched."""


def initial_curve(left: Chain, aligned: Alignment, camera: RectifiedStereo) -> Curve:
    """A curve near the thread, with as many control points as its length in the image calls for."""
    length_px = float(left.along_px[-1])
    count = int(np.clip(round(length_px / (SPAN_SHARE * camera.image_width)) + DEGREE, FEWEST, MOST))
    knots = clamped_uniform_knots(count, DEGREE)
    image = _smooth(knots, left.along_px / length_px, left.point_px, 1.0 / left.deviation_px**2, IMAGE_SMOOTHING)
    disparity = _disparity(knots, aligned, length_px)
    at = np.linspace(0.0, 1.0, 6 * count)
    basis = basis_matrix(knots, DEGREE, at)
    low, high = np.percentile(aligned.disparity_px, [2, 98])
    margin = max(2.0, EXTRAPOLATION * float(high - low))
    bounded = np.clip((basis @ disparity)[:, 0], max(LEAST_DISPARITY_PX, low - margin), high + margin)
    points = backproject(camera, basis @ image, depth_of_disparity(camera, bounded))
    return at_constant_speed(Curve(knots, fitted(knots, at, points)), at)[0]


def _disparity(knots: Float64[np.ndarray, "k"], aligned: Alignment, length_px: float) -> Float64[np.ndarray, "m 1"]:
    """Disparity over length, by iteratively reweighted least squares."""
    s = aligned.along_px / length_px
    basis = basis_matrix(knots, DEGREE, s)
    weight = 1.0 / (aligned.variance_px2 + 0.05)
    robust = np.ones(len(s))
    found = np.zeros((basis.shape[1], 1))
    for _ in range(ROUNDS):
        found = _smooth(knots, s, aligned.disparity_px[:, None], weight * robust, DISPARITY_SMOOTHING)
        residual = np.abs(basis @ found[:, 0] - aligned.disparity_px) * np.sqrt(weight)
        scale = max(1.4826 * float(np.median(residual)), 0.3)
        robust = 1.0 / (1.0 + (residual / (ROBUST * scale)) ** 2)
    return found


def _smooth(
    knots: Float64[np.ndarray, "k"],
    s: Float64[np.ndarray, "n"],
    values: Float64[np.ndarray, "n d"],
    weight: Float64[np.ndarray, "n"],
    smoothing: float,
) -> Float64[np.ndarray, "m d"]:
    """Control points of a spline through weighted values, of small second derivative."""
    basis = basis_matrix(knots, DEGREE, s)
    spans = len(knots) - 2 * DEGREE - 1
    second = difference_matrix(knots, DEGREE, 2) / spans**2
    normal = basis.T @ (weight[:, None] * basis)
    size = max(float(np.trace(normal)) / len(normal), 1e-9)
    H = normal + smoothing * size * second.T @ second + 1e-9 * size * np.eye(len(normal))
    return np.asarray(scipy.linalg.solve(H, basis.T @ (weight[:, None] * values), assume_a="pos"))
