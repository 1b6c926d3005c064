"""Where a calibrated pair sees points, how far corners of a board are off, and the rectified frames of both eyes."""

import cv2
import numpy as np
from jaxtyping import Float64

from schemas.messages import StereoCalibration
from shared.calibration.estimation.board import Board
from shared.calibration.estimation.coverage import View


def residuals_px(
    calibration: StereoCalibration, view: View, board: Board, T_left_board: Float64[np.ndarray, "4 4"]
) -> tuple[Float64[np.ndarray, "c 2"], Float64[np.ndarray, "c 2"]]:
    """What is left at each corner of a view in both images, seen minus expected, given how the board stands."""
    points = board.points[view.number] @ T_left_board[:3, :3].T + T_left_board[:3, 3]
    left, right = seen_by(calibration, points)
    return view.left - left, view.right - right


def seen_by(
    calibration: StereoCalibration, points: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]:
    """The pixels of both images that show points of the left camera's frame."""
    in_right = points @ calibration.T_right_left[:3, :3].T + calibration.T_right_left[:3, 3]
    left = _projected(points, calibration.K_left, calibration.distortion_left)
    return left, _projected(in_right, calibration.K_right, calibration.distortion_right)


def rectifying(
    calibration: StereoCalibration,
) -> tuple[
    Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3 4"], Float64[np.ndarray, "3 4"]
]:
    """Rotations into the rectified frames of both eyes, and the projections there (cv2.stereoRectify)."""
    found = cv2.stereoRectify(
        np.array(calibration.K_left),
        _coefficients(calibration.distortion_left),
        np.array(calibration.K_right),
        _coefficients(calibration.distortion_right),
        (calibration.image_width, calibration.image_height),
        np.array(calibration.T_right_left[:3, :3]),
        np.array(calibration.T_right_left[:3, 3:]),
        alpha=-1,
    )
    R_l, R_r, P_l, P_r = (np.asarray(part, np.float64) for part in found[:4])
    return R_l, R_r, P_l, P_r


def undistorted(
    px: Float64[np.ndarray, "c 2"],
    K: Float64[np.ndarray, "3 3"],
    distortion: Float64[np.ndarray, "d"],
    R: Float64[np.ndarray, "3 3"],
    P: Float64[np.ndarray, "3 4"] | None = None,
) -> Float64[np.ndarray, "c 2"]:
    """Pixels of an image in the rectified one, by the projection P there; slopes of their rays without P."""
    rectified = cv2.undistortPoints(px[:, None], np.array(K), _coefficients(distortion), R=R, P=P)
    return np.asarray(rectified, np.float64)[:, 0]


def _projected(
    points: Float64[np.ndarray, "c 3"], K: Float64[np.ndarray, "3 3"], distortion: Float64[np.ndarray, "d"]
) -> Float64[np.ndarray, "c 2"]:
    px, _ = cv2.projectPoints(np.ascontiguousarray(points), np.zeros(3), np.zeros(3), np.array(K), np.array(distortion))
    return np.asarray(px, np.float64).reshape(-1, 2)


def _coefficients(distortion: Float64[np.ndarray, "d"]) -> Float64[np.ndarray, "d"]:
    return np.array(distortion) if len(distortion) else np.zeros(5)
