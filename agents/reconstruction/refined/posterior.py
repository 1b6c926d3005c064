"""How well each place of the curve is known: the posterior covariance of the fit, and what it cannot know.

The inverse of the Gauss-Newton matrix at the solution is the covariance of the control points, so B(s)'s is a product
with the basis functions. It says what independent errors of the points leave open: much where the thread runs along
the rows, along the line of sight, or out of sight.

Points of a centreline also err together, over longer stretches than the fit averages over: shading and glints move the
middle of a thread's image to one side. A shift common to both images moves the thread sideways, a difference between
them moves its depth, and no residual shows either. Both are taken in proportion to the deviation of the points and to
the thread's width. Where the residuals are smaller than the points' deviations say, the points do not err less: what is
missing is what neighbours err together, in each image by itself.
"""

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.projection import DEGREE, Curve, basis_at
from agents.reconstruction.refined.refinement import Refined
from schemas.messages import RectifiedStereo

COMMON_DEVIATIONS, COMMON_WIDTHS, DIFFERENCE = 1.0, 0.02, 0.3
"""A shift of long stretches in both images: as a multiple of the points' deviation, and of the thread's width, whose
shading causes it; and the share of it by which the two images differ."""
MODEL = 2.0
"""Of the fit's own variance: no thread is exactly as smooth everywhere as the nearby third differences say."""
LEAST_SINE = 0.1
"""Of the angle between thread and line of sight: nearer to that, depth is hardly an error across the thread."""
LEAST = 1e-100
SQRT_2 = np.sqrt(2.0)


def point_covariance(
    fit: Refined, camera: RectifiedStereo, s: Float64[np.ndarray, "q"]
) -> Float64[np.ndarray, "q 3 3"]:
    """Covariance of the curve's points at parameters s, in the unit of the calibration."""
    first, basis, _ = basis_at(fit.curve.spans, s)
    near = first[:, None] + np.arange(DEGREE + 1)
    blocks = fit.covariance[near[:, :, None], :, near[:, None, :], :]
    own = np.einsum("qi,qijab,qj->qab", basis, blocks, basis)
    covariance = MODEL * own + _shared_errors(fit, camera, s)
    return covariance + sliding(fit.curve, covariance, s)


def sliding(
    curve: Curve, covariance: Float64[np.ndarray, "q 3 3"], s: Float64[np.ndarray, "q"]
) -> Float64[np.ndarray, "q 3 3"]:
    """What an error of depth does to second order, where the thread is bent and runs at an angle to the line of sight.

    Moved along the lines of sight, a curve also slides through the plane across it, by t = depth error times the
    tangent of that angle, and what passes there then lies half t² times the curvature aside: the mean square of that
    is 3/4 of the square of t's variance. Slides longer than the radius of curvature are cut off.
    """
    point, velocity, second = curve.derivatives(s)
    square = np.maximum((velocity**2).sum(axis=1), LEAST)
    tangent = velocity / np.sqrt(square)[:, None]
    curvature = (second - (second * tangent).sum(axis=1)[:, None] * tangent) / square[:, None]
    ray = point / np.maximum(np.linalg.norm(point, axis=1), LEAST)[:, None]
    along = (ray * tangent).sum(axis=1)
    across = ray - along[:, None] * tangent
    size = np.maximum(np.linalg.norm(across, axis=1), LEAST)
    depth = np.einsum("qi,qij,qj->q", across, covariance, across) / size**2
    slide = depth * (along / np.maximum(size, LEAST_SINE)) ** 2
    slide = slide / (1.0 + slide * (curvature**2).sum(axis=1))
    return 0.75 * slide[:, None, None] ** 2 * curvature[:, :, None] * curvature[:, None, :]


def _shared_errors(fit: Refined, camera: RectifiedStereo, s: Float64[np.ndarray, "q"]) -> Float64[np.ndarray, "q 3 3"]:
    """What long stretches err together, from (u, v, disparity) to the camera frame."""
    stated_px = float(np.median(fit.sight.deviation_px))
    shift_px = np.hypot(COMMON_DEVIATIONS * fit.scale * stated_px, COMMON_WIDTHS * fit.sight.width_px)
    # errors of two images by themselves: half their variance is that of the mean, and twice it that of the difference
    unseen_px = stated_px * np.sqrt(max(0.0, 1.0 - fit.scale**2))
    aside_px, apart_px = np.hypot(shift_px, unseen_px / SQRT_2), np.hypot(DIFFERENCE * shift_px, SQRT_2 * unseen_px)
    x, y, z = fit.curve.at(s).T
    by_disparity = -(z**2) / (camera.fx_px * camera.baseline)
    columns = np.zeros((len(s), 3, 3))
    columns[:, 0, 0] = aside_px * z / camera.fx_px
    columns[:, 1, 1] = aside_px * z / camera.fy_px
    columns[:, :, 2] = apart_px * (by_disparity / z)[:, None] * np.column_stack((x, y, z))
    return np.einsum("qij,qkj->qik", columns, columns)
