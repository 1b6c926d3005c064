"""How well views of a board determine what is measured with the calibration that was estimated from them.

The corners' errors are taken as independent, as large as the residuals say. Least squares then leaves the parameters of
both lenses and of the way between them with the covariance σ² (A - B D⁻¹ Bᵀ)⁻¹, where A, B and D are the blocks of JᵀJ
for these parameters, and for how each board stands. What that means for measurements is told where the corners lie, for
beyond them lenses are extrapolated: how their rays, rectified, change with each parameter, in least squares as one of
the eight errors of a rectified pair.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from schemas.messages import StereoCalibration
from shared.calibration.estimation.board import Board
from shared.calibration.estimation.coverage import View
from shared.calibration.estimation.projection import rectifying, residuals_px, seen_by, undistorted
from shared.calibration.uncertainty import ERRORS
from shared.rigid_transforms import exp_so3, transform

INTRINSICS, EYE = 4, 9
"""f_x, f_y, c_x, c_y; and with five coefficients of the lens."""
COUNT = 2 * EYE + 6
POSE = 6
STEP = 1e-4
"""Of angles, and of shares of a length: small beside what bends, large beside rounding."""
CORNERS = 400
"""By which the errors are told, of all that the views show."""
NEGLIGIBLE = 1e-12


def error_covariance(
    calibration: StereoCalibration,
    views: tuple[View, ...],
    board: Board,
    T_left_board: Float64[np.ndarray, "n 4 4"],
    fixed: tuple[int, ...] = (),
) -> Float64[np.ndarray, "8 8"]:
    """Covariance of the eight errors (`uncertainty.ERRORS`) of an estimated calibration.

    Args:
        fixed: numbers of a lens's coefficients that were not estimated.
    """
    distance = float(np.median(T_left_board[:, 2, 3]))
    free = [k for k in range(COUNT) if not (k < 2 * EYE and k % EYE - INTRINSICS in fixed)]
    normal, square, count = np.zeros((len(free), len(free))), 0.0, 0
    for view, T in zip(views, T_left_board, strict=True):
        here = np.concatenate(residuals_px(calibration, view, board, T)).ravel()
        moved = [residuals_px(_moved(calibration, k), view, board, T) for k in free]
        moved += [residuals_px(calibration, view, board, _turned(T, k, distance)) for k in range(POSE)]
        slope = np.stack([(np.concatenate(both).ravel() - here) / STEP for both in moved], axis=1)
        of_lens, of_pose = slope[:, : len(free)], slope[:, len(free) :]
        # what no pose of the board explains
        rest = of_lens - of_pose @ np.linalg.lstsq(of_pose, of_lens, rcond=None)[0]
        normal += rest.T @ rest
        square, count = square + float(here @ here), count + len(here)
    variance = square / max(count - len(free) - POSE * len(views), 1)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), NEGLIGIBLE))
    covariance = scale[:, None] * np.linalg.pinv(scale[:, None] * normal * scale, rcond=NEGLIGIBLE) * scale * variance
    corners = np.concatenate(
        [board.points[view.number] @ T[:3, :3].T + T[:3, 3] for view, T in zip(views, T_left_board, strict=True)]
    )[:: max(1, sum(len(view.number) for view in views) // CORNERS)]
    effect = errors_of(calibration, [_moved(calibration, k) for k in free], corners) / STEP
    found = effect @ covariance @ effect.T
    return 0.5 * (found + found.T)


def errors_of(
    calibration: StereoCalibration, others: list[StereoCalibration], points: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "8 k"]:
    """The eight errors of other calibrations against this one, by what they make of the same pixels.

    Args:
        points: in the left camera's frame, where it matters.
    """
    left, right = seen_by(calibration, points)
    here = _rays(calibration, left, right)
    model = _model(here)
    weight = np.concatenate((np.ones(2 * len(left)), points[:, 2] / _baseline(calibration)))
    rays = np.stack([_columns(_rays(other, left, right) - here) for other in others], axis=1)
    baselines = np.array([_baseline(other) / _baseline(calibration) - 1.0 for other in others])
    # a longer baseline is seen by nothing in the images
    known = [k for k in range(len(ERRORS)) if ERRORS[k] != "baseline"]
    found = np.zeros((len(ERRORS), len(others)))
    found[known] = np.linalg.lstsq(weight[:, None] * model[:, known], weight[:, None] * rays, rcond=None)[0]
    found[ERRORS.index("baseline")] = baselines
    return found


def _model(rays: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m 8"]:
    """How rectified rays (x, y of the left eye, x of the right one less it) change with each error."""
    x, y, apart = rays.T
    right = x + apart
    nothing, one = np.zeros_like(x), np.ones_like(x)
    of_x = np.stack((nothing, nothing, nothing, -x, nothing, nothing, -one, nothing), axis=1)
    of_y = np.stack((nothing, nothing, nothing, -y, nothing, nothing, nothing, -one), axis=1)
    of_apart = np.stack((-right * y, 1.0 + right**2, -y, -apart, right, nothing, nothing, nothing), axis=1)
    return np.concatenate((of_x, of_y, of_apart))


def _columns(rays: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m"]:
    return rays.T.ravel()


def _rays(
    calibration: StereoCalibration, left: Float64[np.ndarray, "n 2"], right: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "n 3"]:
    """Of the rectified pair: x and y of the left eye, and x of the right one less that of the left one."""
    R_l, R_r, *_ = rectifying(calibration)
    of_left = undistorted(left, calibration.K_left, calibration.distortion_left, R_l)
    of_right = undistorted(right, calibration.K_right, calibration.distortion_right, R_r)
    return np.column_stack((of_left, of_right[:, 0] - of_left[:, 0]))


def _baseline(calibration: StereoCalibration) -> float:
    return float(np.linalg.norm(calibration.T_right_left[:3, 3]))


def _moved(calibration: StereoCalibration, number: int) -> StereoCalibration:
    """The calibration with one of its parameters a step on: lengths by a share of the focal length or baseline."""
    K = [calibration.K_left.copy(), calibration.K_right.copy()]
    lens = [_five(calibration.distortion_left), _five(calibration.distortion_right)]
    T_right_left = calibration.T_right_left
    eye, which = divmod(number, EYE)
    if number >= 2 * EYE:
        T_right_left = _turned(T_right_left, number - 2 * EYE, _baseline(calibration))
    elif which < INTRINSICS:
        at = ((0, 0), (1, 1), (0, 2), (1, 2))[which]
        K[eye][at] += STEP * K[eye][0, 0]
    else:
        lens[eye][which - INTRINSICS] += STEP
    return replace(
        calibration,
        K_left=K[0],
        K_right=K[1],
        distortion_left=lens[0],
        distortion_right=lens[1],
        T_right_left=T_right_left,
    )


def _five(distortion: Float64[np.ndarray, "d"]) -> Float64[np.ndarray, "5"]:
    return np.concatenate((distortion, np.zeros(EYE - INTRINSICS)))[: EYE - INTRINSICS]


def _turned(T: Float64[np.ndarray, "4 4"], axis: int, length: float) -> Float64[np.ndarray, "4 4"]:
    """A transform turned by a step about an axis, or shifted along it by that share of a length."""
    turn, shift = np.zeros(3), np.zeros(3)
    (turn if axis < 3 else shift)[axis % 3] = STEP
    return transform(exp_so3(turn) @ T[:3, :3], T[:3, 3] + length * shift)
