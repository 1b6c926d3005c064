"""The spline that both images agree on: Gauss-Newton on its control points, with smoothing from the images.

    min  ½ Σ ρ(r_i) + ½ λ Σ_k w_k ‖Δ³P_k‖²

ρ is Cauchy's, so that wrong points lose their say. Between steps the curve is brought back to constant speed, and each
sighting to the place nearest to it. How far apart the rows of both images are is estimated (`rows`): a calibration that
is a little off would otherwise bend the depth.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.near_inverse import near_inverse
from agents.reconstruction.refined.normal_equations import (
    Blocks,
    Rows,
    damping_blocks,
    data_blocks,
    factored,
    finite,
    gradient,
    linearised,
    roughness_blocks,
    solved,
)
from agents.reconstruction.refined.projection import LEVEL, Curve, at_constant_speed
from agents.reconstruction.refined.rows import row_doubt, row_offset, row_prior, rows_information
from agents.reconstruction.refined.sightings import Sightings, folds, placed
from agents.reconstruction.refined.smoothing import COARSE, FINE, chosen_smoothing, local_weights
from schemas.messages import RectifiedStereo
from shared.calibration.uncertainty import usual_covariance

STEPS = 7
ROBUST, ROBUST_END = 2.5, 10.0
"""Residuals beyond so many deviations count less and less: of points, and of the thread's end along it."""
LOOSER = 3.0
"""No thread is as smooth everywhere as the third differences nearby say: in the posterior, and where rows are sought,
they count so much less."""
FREE = 10.0
"""And so much less where it is told how uncertain rows remain: smoothness alone tells them from depth. Fitted: with it
the 95 % ellipse holds 94 % of places under drawn calibrations, with LOOSER 91 % (benchmarks.calibrations)."""
LEAST_SCALE, MOST_SCALE = 0.1, 4.0
"""Of the deviations that perception states, by the spread of the residuals."""


@dataclass(frozen=True)
class Refined:
    """A curve with what it was fitted to.

    Fields:
        scale: of the stated deviations, by the residuals.
        smoothing, weight: λ, and w of each span.
        row_offset_px: how many rows the right image lies lower, by the terms of `rows`.
        total: the quadratic function at the solution.
        loose: the same for a thread that need not be as smooth; the inverse of its matrix is the posterior covariance.
        alone: of that, what this frame says by itself.
        free: of that, with hardly any smoothness.
        follows: whether frames before have a say in the others.
        row_doubt: factor of what uncertain rows add to that; None where the calibration is exact.
    """

    curve: Curve
    sight: Sightings
    rows: Rows
    robust: Float64[np.ndarray, "n"]
    scale: float
    smoothing: float
    weight: Float64[np.ndarray, "spans"]
    row_offset_px: Float64[np.ndarray, "4"]
    total: Blocks
    loose: Blocks
    alone: Blocks
    free: Blocks
    follows: bool = False
    row_doubt: Float64[np.ndarray, "v k"] | None = None

    @cached_property
    def covariance(self) -> Float64[np.ndarray, "spans 12 12"]:
        """Of the control points of each span, by the fit alone."""
        return near_inverse(self.loose)


@dataclass(frozen=True)
class Start:
    """Where refinement begins; without a smoothing it is sought over the whole grid."""

    curve: Curve
    sight: Sightings
    smoothing: float | None = None
    weight: Float64[np.ndarray, "spans"] | None = None
    row_offset_px: Float64[np.ndarray, "4"] = field(default_factory=LEVEL.copy)
    of_calibration: Float64[np.ndarray, "8 8"] = field(default_factory=usual_covariance)


def refined(start: Start, camera: RectifiedStereo, steps: int | None = None) -> Refined:
    """The fit that starts from a curve within some pixels of the thread.

    Raises:
        numpy.linalg.LinAlgError: where the equations have no solution.
    """
    curve, offset_px, known = start.curve, start.row_offset_px, row_prior(start.of_calibration, camera)
    weight = np.ones(curve.spans) if start.weight is None else start.weight
    # nothing is known of the smoothing before the first step chooses it
    smoothing = start.smoothing or 1.0
    sight = placed(start.sight, curve, camera, offset_px, rounds=3)
    for step in range(STEPS if steps is None else steps):
        rows, robust, scale = weighted(curve, sight, camera, offset_px)
        data = data_blocks(rows, robust / scale**2, curve.spans) + damping_blocks(curve)
        if step in (1, 2) or (step == 0 and start.smoothing is None):
            near = COARSE if step == 0 else smoothing * FINE
            smoothing = chosen_smoothing(curve, data, weight, near)
        total = data + roughness_blocks(curve, smoothing * weight)
        if step >= 2:
            weight = local_weights(curve, total, smoothing, weight)
            total = data + roughness_blocks(curve, smoothing * weight)
        factor = factored(total)
        motion = -solved(factor, gradient(total.g))
        if step > 0 and known.any():
            loose = data + roughness_blocks(curve, smoothing * weight / LOOSER)
            loosely = factored(loose)
            said = rows_information(rows, robust / scale**2, loosely, -solved(loosely, gradient(loose.g)))
            change_px = row_offset(said, offset_px, known) - offset_px
            motion, offset_px = motion - solved(factor, said.columns) @ change_px, offset_px + change_px
        curve = curve.moved(finite(motion).reshape(-1, 3))
        curve, s = at_constant_speed(curve, sight.s, folds(sight, curve, camera))
        sight = placed(replace(sight, s=s), curve, camera, offset_px)
    rows, robust, scale = weighted(curve, sight, camera, offset_px)
    data = data_blocks(rows, robust / scale**2, curve.spans) + damping_blocks(curve)
    smooth = roughness_blocks(curve, smoothing * weight)
    total, loose, free = data + smooth, data + smooth * (1.0 / LOOSER), data + smooth * (1.0 / FREE)
    fit = Refined(curve, sight, rows, robust, scale, smoothing, weight, offset_px, total, loose, loose, free)
    return with_row_doubt(fit, camera, start.of_calibration)


def with_row_doubt(fit: Refined, camera: RectifiedStereo, of_calibration: Float64[np.ndarray, "8 8"]) -> Refined:
    """The same, with what its frame leaves uncertain of the rows."""
    known = row_prior(of_calibration, camera)
    if not known.any():
        return fit
    said = rows_information(fit.rows, fit.robust / fit.scale**2, factored(fit.free))
    return replace(fit, row_doubt=row_doubt(said, known))


def weighted(
    curve: Curve, sight: Sightings, camera: RectifiedStereo, row_offset_px: Float64[np.ndarray, "4"]
) -> tuple[Rows, Float64[np.ndarray, "n"], float]:
    """Linearised residuals, what each has to say still, and the spread of them all."""
    rows = linearised(curve, sight, camera, row_offset_px)
    scale = float(np.clip(1.4826 * np.median(np.abs(rows.residual[: rows.sightings])), LEAST_SCALE, MOST_SCALE))
    robust = 1.0 / (1.0 + (rows.residual / (ROBUST * scale)) ** 2)
    # what lies beyond an end of the curve has its nearest place there, and says nothing of it
    beyond = ((sight.s <= 0.0) | (sight.s >= 1.0)) & ~sight.is_end
    robust[: rows.sightings][beyond] = 0.0
    # the left chain's ends say how far the curve goes, and nothing else does: they keep their say
    end = np.flatnonzero(sight.is_end)
    robust[rows.sightings + np.flatnonzero(sight.eye[end] == 0)] = 1.0
    # as they are the same ends, those of the right one share in that unless they are far away
    right = rows.sightings + np.flatnonzero(sight.eye[end] == 1)
    robust[right] = 1.0 / (1.0 + (rows.residual[right] / (ROBUST_END * scale)) ** 2)
    return rows, robust, scale
