"""How far apart the rows of both images are, where the calibration is a little off.

A camera that is turned by a small ω sees what lies at (x, y, 1) at (x, y, 1) + ω × (x, y, 1) instead, and brought back
to the plane at distance 1 that moves it in y by

    ω_z x + ω_y x y − ω_x (1 + y²).

Another focal length adds a share of y, another principal point a constant. ω_x y² is below 0.2 px at the rim for 0.1°
and left out, so that the right image lies lower than the left one by

    o(x, y) = o₀ + o_x x + o_y y + o_xy x y,

all four in pixels. Which camera is off nobody can tell, so each image has half of it. How large they may be follows
from what the calibration may be off by: their covariance C beforehand.

With q_j = ∂r/∂o_j, the motion m of the control points without any change of o, and Schur's complement
M = QᵀWQ − QᵀWJ H⁻¹ JᵀWQ (information about o with the curve left free), they are

    o' = C (I + M C)⁻¹ (M o − QᵀWr − QᵀWJ m),

and C (I + M C)⁻¹ is their covariance then. On a thread that is short or nearly straight in the image depth can bend
instead: M is small, and the offset stays what the calibration says.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.normal_equations import Rows, gradient, row_offset_columns, solved
from agents.reconstruction.refined.projection import DEGREE, LEVEL
from schemas.messages import RectifiedStereo
from shared.calibration.uncertainty import ERRORS


@dataclass(frozen=True)
class RowsInformation:
    """What residuals say of the rows, the curve left free.

    Fields:
        matrix: M.
        slope: QᵀWr + QᵀWJ m.
        follow: H⁻¹ JᵀWQ; the control points move by −follow δ more.
        columns: JᵀWQ.
    """

    matrix: Float64[np.ndarray, "4 4"]
    slope: Float64[np.ndarray, "4"]
    follow: Float64[np.ndarray, "v 4"]
    columns: Float64[np.ndarray, "v 4"]


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
    return RowsInformation(alone - columns.T @ follow, slope, follow, columns)


def row_prior(of_calibration: Float64[np.ndarray, "8 8"], camera: RectifiedStereo) -> Float64[np.ndarray, "4 4"]:
    """C, in pixels, from the covariance of the calibration's errors."""
    terms = np.zeros((len(LEVEL), len(ERRORS)))
    # a turn about x, y and z; another focal length
    for term, (error, sign) in enumerate((("pitch", -1), ("roll", 1), ("focal_apart", 1), ("vergence", 1))):
        terms[term, ERRORS.index(error)] = sign * camera.fy_px
    return terms @ of_calibration @ terms.T


def row_offset(
    said: RowsInformation, offset_px: Float64[np.ndarray, "4"], prior: Float64[np.ndarray, "4 4"]
) -> Float64[np.ndarray, "4"]:
    """The most probable row offset."""
    return _posterior(said, prior) @ (said.matrix @ offset_px - said.slope)


def row_doubt(said: RowsInformation, prior: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "v 4"]:
    """A factor of the covariance that the uncertainty of the row offset brings to the control points."""
    variance, axes = np.linalg.eigh(_posterior(said, prior))
    return said.follow @ (axes * np.sqrt(np.maximum(variance, 0.0)))


def _posterior(said: RowsInformation, prior: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
    covariance = np.linalg.solve(np.eye(len(LEVEL)) + prior @ said.matrix, prior)
    return 0.5 * (covariance + covariance.T)
