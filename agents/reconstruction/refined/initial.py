"""The first curve: course in the left image and disparity as smooth functions of the length along it, robustly."""

import numpy as np
from jaxtyping import Float64
from scipy.linalg import lapack

from agents.reconstruction.refined.alignment import Alignment
from agents.reconstruction.refined.normal_equations import finite
from agents.reconstruction.refined.paths import Chain
from agents.reconstruction.refined.projection import (
    DEGREE,
    Curve,
    at_constant_speed,
    design_matrix,
    even_places,
    fitted,
    kept,
)
from schemas.messages import RectifiedStereo
from shared.camera import backproject, depth_of_disparity
from shared.splines import clamped_uniform_knots, difference_matrix

ROUNDS = 4
SPAN_SHARE = 0.021
"""Of the image's width: what one span of the spline covers at least, some widths of thread."""
FEWEST, MOST = 12, 70
MORE_SPANS = 1.3
"""Fewer more than that change nothing."""
IMAGE_SMOOTHING, DISPARITY_SMOOTHING = 1e-3, 1e-1
ROBUST = 2.5
LEAST_DISPARITY_PX = 0.3
LEAST_VARIANCE_PX2 = 0.05
EXTRAPOLATION = 0.3
"""Of the range of matched disparities: how far a curve may leave it where nothing is matched."""


def initial_curve(
    left: Chain, aligned: Alignment, share: Float64[np.ndarray, "n"], camera: RectifiedStereo
) -> tuple[Curve, Float64[np.ndarray, "n"]]:
    """A curve near the thread, with as many control points as its length in the image calls for.

    Also the parameters at which the left chain has these shares of its length behind it: in space, other stretches of
    the thread are long than in the image.
    """
    length_px = float(left.along_px[-1])
    spans = _spans_for(length_px, camera)
    shown = design_matrix(spans, left.along_px / length_px)
    image = _smooth(shown, left.point_px, 1.0 / left.deviation_px**2, IMAGE_SMOOTHING)
    disparity = _disparity(design_matrix(spans, aligned.along_px / length_px), aligned)
    basis = design_matrix(spans, even_places(spans))
    low, high = np.percentile(aligned.disparity_px, [2, 98])
    margin = max(2.0, EXTRAPOLATION * float(high - low))
    bounded = np.clip(basis @ disparity, max(LEAST_DISPARITY_PX, low - margin), high + margin)
    points = backproject(camera, basis @ image, depth_of_disparity(camera, bounded))
    curve = Curve(clamped_uniform_knots(spans + DEGREE, DEGREE), fitted(spans, finite(points)))
    return at_constant_speed(curve, share)


def with_needed_spans(curve: Curve, camera: RectifiedStereo) -> Curve | None:
    """The same curve with as many spans as it would have if it were seen from the side; None where that is no more.

    What runs along the line of sight is short in the image, and so has too few spans to bend as the thread does.
    """
    points = curve.at(even_places(curve.spans))
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    needed = _spans_for(float((chords * camera.fx_px / points[1:, 2]).sum()), camera)
    if needed < MORE_SPANS * curve.spans:
        return None
    return Curve(clamped_uniform_knots(needed + DEGREE, DEGREE), fitted(needed, curve.at(even_places(needed))))


def _spans_for(length_px: float, camera: RectifiedStereo) -> int:
    """How many spans a thread needs that is so long in the image."""
    return int(np.clip(round(length_px / (SPAN_SHARE * camera.image_width)), FEWEST - DEGREE, MOST - DEGREE))


def _disparity(basis: Float64[np.ndarray, "k m"], aligned: Alignment) -> Float64[np.ndarray, "m"]:
    """Disparity over length, by iteratively reweighted least squares."""
    weight = 1.0 / (aligned.variance_px2 + LEAST_VARIANCE_PX2)
    robust = np.ones(len(weight))
    found = np.zeros(basis.shape[1])
    for _ in range(ROUNDS):
        found = _smooth(basis, aligned.disparity_px, weight * robust, DISPARITY_SMOOTHING)
        residual = np.abs(basis @ found - aligned.disparity_px) * np.sqrt(weight)
        scale = max(1.4826 * np.median(residual), 0.3)
        robust = 1.0 / (1.0 + (residual / (ROBUST * scale)) ** 2)
    return found


def _smooth(
    basis: Float64[np.ndarray, "n m"],
    values: Float64[np.ndarray, "n *d"],
    weight: Float64[np.ndarray, "n"],
    smoothing: float,
) -> Float64[np.ndarray, "m *d"]:
    """Control points of a spline through weighted values, of small second derivative."""
    weighted = basis.T * weight
    normal = weighted @ basis
    size = max(float(np.trace(normal)) / len(normal), 1e-9)
    H = normal + smoothing * size * _second_differences(basis.shape[1]) + 1e-9 * size * np.eye(len(normal))
    # LAPACK itself: SciPy's checks take as long as the solution
    _, found, info = lapack.dposv(H, weighted @ values)
    if info:
        raise np.linalg.LinAlgError("no first curve follows from the points of both images")
    return found


@kept
def _second_differences(count: int) -> Float64[np.ndarray, "m m"]:
    """The sum of squares of the second derivative at the knots, for knot spans of length 1."""
    second = difference_matrix(clamped_uniform_knots(count, DEGREE), DEGREE, 2) / (count - DEGREE) ** 2
    return second.T @ second
