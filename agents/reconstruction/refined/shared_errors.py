"""What neighbouring points of one image err together, and how far the curve follows them.

Light from beside, shadows and covers move the middle of a thread's image over long stretches, in each image by itself.
The fit averages none of that out, and no residual shows it. So each image has a slow error along the curve: independent
amplitudes some way apart, between which it goes over as sine and cosine, so that its variance is the same everywhere.
What the curve makes of each is its own answer to points that are moved so,

    δP = H⁻¹ Jᵀ W ε:

a tenth of a pixel is a tenth of a pixel of disparity where the thread crosses the rows, and one where it climbs by a
tenth.
"""

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.normal_equations import SIDE, factored, solved
from agents.reconstruction.refined.projection import DEGREE, chords, projected
from agents.reconstruction.refined.refinement import Refined
from schemas.messages import RectifiedStereo

REACH_SHARE = 0.08
"""Of the image's width, from one amplitude to the next: how far shading moves the middle alike, by its correlation."""
SAMPLED_PX = 0.025
"""So much of a stated deviation may come from sampling by pixels, anew in each place; what is more is shared."""
PLACES_OF_SPAN = 4
LEAST_SPEED_PX = 1e-9


def shared_errors(fit: Refined, camera: RectifiedStereo) -> Float64[np.ndarray, "v k"]:
    """A factor of the covariance that they bring to the control points."""
    sight, count = fit.sight, fit.rows.sightings
    place, bent, columns = np.empty(count), np.empty(count), 0
    for eye in (0, 1):
        here = sight.eye == eye
        dense, along_px, curvature_px = _image_of(fit, eye, camera)
        stretches = max(1, round(along_px[-1] / (REACH_SHARE * camera.image_width)))
        share = np.interp(sight.s[here], dense, along_px) / max(along_px[-1], LEAST_SPEED_PX)
        place[here] = columns + stretches * share
        bent[here] = np.interp(sight.s[here], dense, curvature_px)
        columns += stretches + 1
    error = _error_px(fit, bent) / sight.deviation_px
    return solved(factored(fit.alone), _moved_by(fit, place, error, columns))


def _error_px(fit: Refined, curvature_px: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """The deviation of each point's share in a slow error.

    Where the image of the thread turns within its own width, as it does along the line of sight, the middle of what is
    seen is not the image of the middle, by up to half of the width.
    """
    sight = fit.sight
    stated = sight.deviation_px / sight.raised
    larger = np.maximum(1.0, fit.scale * sight.raised)
    half = 0.5 * sight.width_px
    turned = half * np.minimum((curvature_px * half) ** 2, 1.0)
    return np.hypot(larger * np.sqrt(np.maximum(0.0, stated**2 - SAMPLED_PX**2)), turned)


def _image_of(
    fit: Refined, eye: int, camera: RectifiedStereo
) -> tuple[Float64[np.ndarray, "d"], Float64[np.ndarray, "d"], Float64[np.ndarray, "d"]]:
    """Parameters of the curve, the length of its image before them, and the curvature of that."""
    dense = np.linspace(0.0, 1.0, PLACES_OF_SPAN * fit.curve.spans + 1)
    view = projected(fit.curve, dense, np.full(len(dense), eye), camera, fit.row_offset_px)
    along = np.concatenate(([0.0], np.cumsum(chords(view.point_px))))
    u, v = view.velocity_px.T
    turn = np.abs(np.gradient(np.unwrap(np.arctan2(v, u)), dense))
    return dense, along, turn / np.maximum(np.hypot(u, v), LEAST_SPEED_PX)


def _moved_by(
    fit: Refined, place: Float64[np.ndarray, "n"], error: Float64[np.ndarray, "n"], columns: int
) -> Float64[np.ndarray, "v k"]:
    """JᵀWε for each amplitude; a place between two of them has a share of both."""
    rows, count = fit.rows, fit.rows.sightings
    gradient = (rows.basis[:count, :, None] * rows.gradient[:count, None, :]).reshape(count, SIDE)
    gradient *= (fit.robust[:count] / fit.scale**2 * error)[:, None]
    before = np.floor(place)
    angle = 0.5 * np.pi * (place - before)
    number = 3 * rows.first[:count, None] + np.arange(SIDE)
    size = 3 * (fit.curve.spans + DEGREE)
    total = np.zeros(size * columns)
    for column, part in ((before, np.cos(angle)), (before + 1, np.sin(angle))):
        index = number * columns + np.minimum(column, columns - 1).astype(np.int64)[:, None]
        total += np.bincount(index.ravel(), (gradient * part[:, None]).ravel(), size * columns)
    return total.reshape(size, columns)
