"""How far apart the rows of both images are, where the calibration is a little off.

A camera that is turned by a small ω sees what lies at (x, y, 1) at (x, y, 1) + ω × (x, y, 1) instead, and brought back
to the plane at distance 1 that moves it in y by

    ω_z x + ω_y x y − ω_x (1 + y²).

Another focal length adds a share of y, another principal point a constant. ω_x y² is below 0.2 px at the rim for 0.1°
and left out, so that the right image lies lower than the left one by

    o(x, y) = o₀ + o_x x + o_y y + o_xy x y,

all four in pixels. Which camera is off nobody can tell, so each image has half of it. The constant has no prior; the
others are known to the size of a careful calibration's errors, and are used where the images are much more probable
with them: on a thread that is short or nearly straight in the image, depth can bend instead.

With q_j = ∂r/∂o_j, the motion m of the control points without any change of o, and Schur's complement
M = QᵀWQ − QᵀWJ H⁻¹ JᵀWQ (information about o with the curve left free), the change is

    δ = −(M + Λ)⁻¹ (QᵀWr + QᵀWJ m + Λ o),

and the logarithm of how much more probable the images become by integrating o out, ½ bᵀ(M + Λ)⁻¹b − ½ log|I + Λ⁻¹M|.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.cubic import DEGREE
from agents.reconstruction.refined.normal_equations import Rows, gradient, row_offset_columns, solved
from agents.reconstruction.refined.projection import LEVEL
from schemas.messages import RectifiedStereo

LEAST_ROW_OFFSET_PX, CERTAIN = 0.08, 3.0
LEAST_OWN_SHARE, LEAST_TERMS_SHARE = 1e-3, 0.03
"""Of what the points say of a row offset, and of its further terms, what must be left where depth is free: less is owed
to smoothness alone."""
TURN, FOCAL = 1.75e-3, 1.5e-3
"""Deviations of a calibration: of an angle, 0.1°, and of the ratio of two focal lengths."""
CONVINCING = 5.0
"""Logarithm of how much more probable the images must be with the further terms."""


@dataclass(frozen=True)
class RowsInformation:
    """What residuals say of the rows, the curve left free.

    Fields:
        alone, matrix: QᵀWQ, and M, what is left of it.
        slope: QᵀWr + QᵀWJ m.
        follow: H⁻¹ JᵀWQ; the control points move by −follow δ more.
    """

    alone: Float64[np.ndarray, "4 4"]
    matrix: Float64[np.ndarray, "4 4"]
    slope: Float64[np.ndarray, "4"]
    follow: Float64[np.ndarray, "v 4"]


def rows_information(
    rows: Rows,
    weight: Float64[np.ndarray, "n"],
    factor: Float64[np.ndarray, "12 v"],
    motion: Float64[np.ndarray, "v"] | float = 0.0,
) -> RowsInformation:
    """Schur's complement, from residuals, their weights, and the factor of the matrix of the control points."""
    columns = gradient(row_offset_columns(rows, weight, factor.shape[1] // 3 - DEGREE))
    follow = solved(factor, columns)
    alone = (rows.by_row_offset * weight[:, None]).T @ rows.by_row_offset
    slope = rows.by_row_offset.T @ (weight * rows.residual) + columns.T @ (motion + np.zeros(len(columns)))
    return RowsInformation(alone, alone - columns.T @ follow, slope, follow)


def row_change(
    said: RowsInformation, row_offset_px: Float64[np.ndarray, "4"], camera: RectifiedStereo, constant_alone: bool
) -> Float64[np.ndarray, "4"]:
    """The change of the row offset; none where the residuals do not tell.

    Args:
        constant_alone: further terms are out of the question yet.
    """
    change = np.zeros(len(LEVEL))
    information = said.matrix[0, 0]
    if information <= LEAST_OWN_SHARE * said.alone[0, 0]:
        return change
    if not constant_alone:
        precision = _precision(camera)
        terms = -np.linalg.solve(said.matrix + precision, said.slope + precision @ row_offset_px)
        if row_offset_px[1:].any() or _are_told(said, terms, camera):
            return terms
    constant = -said.slope[0] / information
    if abs(constant) >= max(LEAST_ROW_OFFSET_PX, CERTAIN / np.sqrt(information)):
        change[0] = constant
    return change


def row_doubt(
    said: RowsInformation, row_offset_px: Float64[np.ndarray, "4"], camera: RectifiedStereo
) -> Float64[np.ndarray, "v k"]:
    """A factor of the covariance that the uncertainty of the terms in use brings to the control points."""
    used = slice(None) if row_offset_px[1:].any() else slice(1)
    covariance = np.linalg.inv((said.matrix + _precision(camera))[used, used])
    return said.follow[:, used] @ np.linalg.cholesky(covariance)


def _precision(camera: RectifiedStereo) -> Float64[np.ndarray, "4 4"]:
    """Λ: nothing is known of the constant beforehand."""
    return np.diag(np.concatenate(([0.0], (camera.fx_px * np.array([TURN, FOCAL, TURN])) ** -2)))


def _are_told(said: RowsInformation, terms: Float64[np.ndarray, "4"], camera: RectifiedStereo) -> bool:
    """Whether the images visibly need the further terms beside a constant, and not smoothness alone."""
    M, alone, further = _without_constant(said.matrix), _without_constant(said.alone), terms[1:]
    square = float(further @ alone @ further)
    return (
        square > LEAST_ROW_OFFSET_PX**2 * said.alone[0, 0]
        and float(further @ M @ further) > LEAST_TERMS_SHARE * square
        and _evidence(M, said, camera) > CONVINCING
    )


def _without_constant(matrix: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "3 3"]:
    """The constant integrated out."""
    return matrix[1:, 1:] - np.outer(matrix[1:, 0], matrix[0, 1:]) / matrix[0, 0]


def _evidence(left: Float64[np.ndarray, "3 3"], said: RowsInformation, camera: RectifiedStereo) -> float:
    """How much more probable the further terms make the images: the constant has a flat prior on both sides."""
    prior = _precision(camera)[1:, 1:]
    b = said.slope[1:] - said.matrix[1:, 0] * said.slope[0] / said.matrix[0, 0]
    gain = 0.5 * b @ np.linalg.solve(left + prior, b)
    return float(gain - 0.5 * np.linalg.slogdet(np.eye(len(b)) + np.linalg.solve(prior, left))[1])
