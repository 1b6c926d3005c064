"""How well each place of the curve is known: the posterior covariance of the fit, and what it cannot know.

The inverse of the Gauss-Newton matrix at the solution is the covariance of the control points, so B(s)'s is a product
with the basis functions. It says what independent errors of the points leave open: much where the thread runs along
the rows, along the line of sight, or out of sight. What points of one image err together is added (`shared_errors`).
"""

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.projection import DEGREE, Curve, basis_at
from agents.reconstruction.refined.refinement import Refined
from agents.reconstruction.refined.shared_errors import shared_errors
from schemas.messages import RectifiedStereo
from shared.calibration.uncertainty import bending

ALIKE = 2.0
"""Frames that follow each other err alike, as if half of the variance were new in each."""
LEAST_SINE = 0.1
"""Of the angle between thread and line of sight: nearer to that, depth is hardly an error across the thread."""
LEAST = 1e-100


def point_covariance(
    fit: Refined, camera: RectifiedStereo, s: Float64[np.ndarray, "q"]
) -> Float64[np.ndarray, "q 3 3"]:
    """Covariance of the curve's points at parameters s, in the unit of the calibration."""
    first, basis, _ = basis_at(fit.curve.spans, s)
    near = first[:, None] + np.arange(DEGREE + 1)
    # one control point after the other, which leaves all products to the library of matrices
    blocks = fit.covariance[first].reshape(len(s), DEGREE + 1, -1)
    rest = (basis[:, None] @ blocks).reshape(len(s), 3, DEGREE + 1, 3)
    own = (basis[:, None, None] @ rest)[:, :, 0]
    factor = shared_errors(fit, camera)
    if fit.row_doubt is not None:
        factor = np.concatenate((factor, fit.row_doubt), axis=1)
    factor = factor.reshape(len(fit.curve.control_points), -1)
    shared = (basis[:, None] @ factor[near]).reshape(len(s), 3, -1)
    covariance = (ALIKE if fit.follows else 1.0) * own + shared @ shared.transpose(0, 2, 1)
    return covariance + sliding(fit.curve, covariance, s)


def bent_covariance(
    fit: Refined,
    camera: RectifiedStereo,
    s: Float64[np.ndarray, "q"],
    of_calibration: Float64[np.ndarray, "8 8"],
) -> Float64[np.ndarray, "q 3 3"]:
    """What errors of the calibration add where they do not move the whole field alike (`shared.calibration`)."""
    points = fit.curve.at(s)
    moved = bending(camera, points, float(np.median(points[:, 2])))
    return moved @ of_calibration @ moved.transpose(0, 2, 1)


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
