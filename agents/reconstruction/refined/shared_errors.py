"""What neighbouring points err together, in one image and in both, and how far the curve follows them.

Light from beside, shadows and covers move the middle of a thread's image over long stretches. The fit averages none of
that out, and no residual shows it. So images have slow errors along the curve: independent amplitudes some way apart,
between which an error goes over as sine and cosine, so that its variance is the same everywhere. What the curve makes
of each is its own answer to points that are moved so,

    δP = H⁻¹ Jᵀ W ε:

a tenth of a pixel is a tenth of a pixel of disparity where the thread crosses the rows, and one where it climbs by a
tenth.

Both eyes see one thread in one light. Where it runs along the rows they stand apart along it, see it from the same side
and err alike; where it crosses them each sees more of its own side. So with amplitudes a that they have in common and b
by which they differ,

    ε_left, ε_right = σ (C a ∓ D b) / √2,

C² and D² going from their values along the rows to those across them as n_u² / (n_u² + TURNS²), n_u being the part of
the normal that lies along the rows. C = D = 1 are errors of which each eye has its own. Depth errs by what differs.
Thread that rises from the tissue towards the camera errs more than perception states, by 1 + RISING cos² of its angle
to the line of sight. All of these are measured on renders (docs/reconstruction.md).
"""

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.normal_equations import SIDE, factored, solved
from agents.reconstruction.refined.projection import DEGREE, chords, even_parameters, projected_evenly
from agents.reconstruction.refined.refinement import Refined
from schemas.messages import RectifiedStereo

REACH_SHARE = 0.08
"""Of the image's width, from one amplitude to the next: how far shading moves the middle alike, by its correlation."""
SAMPLED_PX = 0.025
"""So much of a stated deviation may come from sampling by pixels, anew in each place; what is more is shared."""
COMMON, DIFFERING, TURNS = (1.1, 0.7), (0.25, 0.85), 0.4
"""C and D along and across the rows, and n_u half-way between."""
RISING = 8.0
PIXELS_PX, USUAL = 0.06, 2.0
"""Far below the one, a stated deviation is that of borders of pixels; what a point states beyond so many times the
median is a cover's or an end's: of both each eye has its own."""
PLACES_OF_SPAN = 4
LEAST_SPEED_PX = 1e-9


def shared_errors(fit: Refined, camera: RectifiedStereo) -> Float64[np.ndarray, "v k"]:
    """A factor of the covariance that they bring to the control points."""
    sight, count = fit.sight, fit.rows.sightings
    dense = even_parameters(fit.curve.spans, PLACES_OF_SPAN)
    bent, across = np.empty(count), np.empty(count)
    along_px, curvature_px, rowwise = _images_of(fit, camera)
    for eye in (0, 1):
        here = sight.eye == eye
        bent[here] = np.interp(sight.s[here], dense, curvature_px[eye])
        across[here] = np.interp(sight.s[here], dense, rowwise[eye])
    stretches = max(1, round(along_px[-1] / (REACH_SHARE * camera.image_width)))
    place = stretches * np.interp(sight.s, dense, along_px) / max(along_px[-1], LEAST_SPEED_PX)
    common, differing = _errors_px(fit, bent, across, _rising(fit))
    side = np.where(sight.eye == 0, -1.0, 1.0)
    moved = _moved_by(fit, place, (common, side * differing), stretches + 1)
    return solved(factored(fit.alone), moved)


def _errors_px(
    fit: Refined,
    curvature_px: Float64[np.ndarray, "n"],
    across: Float64[np.ndarray, "n"],
    rising: Float64[np.ndarray, "n"],
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """The deviation of each point's share in slow errors, in those of both eyes and in those by which they differ.

    Where the image of the thread turns within its own width, as it does along the line of sight, the middle of what is
    seen is not the image of the middle, by up to half of the width.

    Args:
        across: the square of n_u; rising: that of the cosine between thread and line of sight.
    """
    sight = fit.sight
    stated = sight.deviation_px / sight.raised
    larger = np.maximum(1.0, fit.scale * sight.raised)
    slow = larger**2 * np.maximum(0.0, stated**2 - SAMPLED_PX**2)
    light = np.minimum(slow, (USUAL * larger * np.median(stated)) ** 2) * (stated**4 / (stated**4 + PIXELS_PX**4))
    half = 0.5 * sight.width_px
    own = slow - light + (half * np.minimum((curvature_px * half) ** 2, 1.0)) ** 2
    turned = across / (across + TURNS**2)
    (c0, c1), (d0, d1) = COMMON, DIFFERING
    common, differing = c0**2 + (c1**2 - c0**2) * turned, d0**2 + (d1**2 - d0**2) * turned
    light *= 1.0 + RISING * rising
    return np.sqrt(0.5 * (common * light + own)), np.sqrt(0.5 * (differing * light + own))


def _rising(fit: Refined) -> Float64[np.ndarray, "n"]:
    """The square of the cosine between thread and line of sight at each point."""
    point, velocity = (found.T for found in fit.curve.with_velocities(fit.sight.s))
    both = np.einsum("in,in->n", point, point) * np.einsum("in,in->n", velocity, velocity)
    return np.einsum("in,in->n", point, velocity) ** 2 / np.maximum(both, np.finfo(np.float64).tiny)


def _images_of(
    fit: Refined, camera: RectifiedStereo
) -> tuple[Float64[np.ndarray, "d"], Float64[np.ndarray, "2 d"], Float64[np.ndarray, "2 d"]]:
    """The length of the curve's image before each place in the mean of both eyes; its curvature and n_u² in either."""
    view = projected_evenly(fit.curve, PLACES_OF_SPAN, camera, fit.row_offset_px)
    left, right = np.split(view.point_px, 2)
    along = np.concatenate(([0.0], np.cumsum(0.5 * (chords(left) + chords(right)))))
    u, v = view.velocity_px.T.reshape(2, 2, -1)
    turn = np.abs(np.gradient(np.unwrap(np.arctan2(v, u)), 1.0 / (len(along) - 1), axis=1))
    speed = np.maximum(np.hypot(u, v), LEAST_SPEED_PX)
    return along, turn / speed, (v / speed) ** 2


def _moved_by(
    fit: Refined,
    place: Float64[np.ndarray, "n"],
    errors_px: tuple[Float64[np.ndarray, "n"], ...],
    columns: int,
) -> Float64[np.ndarray, "v k"]:
    """JᵀWε for each amplitude of each kind of error; a place between two amplitudes has a share of both."""
    rows, count = fit.rows, fit.rows.sightings
    weight = fit.robust[:count] / fit.scale**2 / fit.sight.deviation_px
    gradient = rows.gradient[:count].T * weight
    gradient = (rows.basis[:count].T[:, None] * gradient).reshape(SIDE, count)
    before = np.floor(place)
    angle = 0.5 * np.pi * (place - before)
    size, width = 3 * (fit.curve.spans + DEGREE), len(errors_px) * columns
    number = (3 * rows.first[:count] + np.arange(SIDE)[:, None]) * width
    total = np.zeros(size * width)
    for column, part in ((before, np.cos(angle)), (before + 1, np.sin(angle))):
        index = number + np.minimum(column, columns - 1).astype(np.int64)
        for kind, error_px in enumerate(errors_px):
            moved = gradient * (part * error_px)
            total += np.bincount((index + kind * columns).ravel(), moved.ravel(), size * width)
    return total.reshape(size, width)
