"""What a calibration is worth on views that it was not made from.

    rows        after rectification a corner must lie on one row of both images
    squares     triangulated corners must be as far apart as they are on the board
    reprojection   the board, placed where it fits both images best, must project to where it is seen

The board's place is the only unknown of a view that was held out: six numbers, against four for every corner.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares

from schemas.messages import StereoCalibration
from shared.calibration.estimation.board import Board
from shared.calibration.estimation.coverage import View
from shared.calibration.estimation.estimate import FEWEST_VIEWS, estimated, rms
from shared.calibration.estimation.projection import rectifying, residuals_px, undistorted
from shared.rigid_transforms import exp_so3, log_so3, transform

FOLDS = 5


@dataclass(frozen=True)
class Checked:
    """What one view says of a calibration.

    Fields:
        rows_px: of each corner, left minus right row after rectification.
        squares: length of each side between neighbouring corners, as a multiple of the board's.
        residual_left_px, residual_right_px: seen minus expected pixel of each corner, with the board where it fits.
        size: how large the board appears against how large it is, from all distances between corners.
    """

    view: View
    rows_px: Float64[np.ndarray, "c"]
    squares: Float64[np.ndarray, "s"]
    size: float
    residual_left_px: Float64[np.ndarray, "c 2"]
    residual_right_px: Float64[np.ndarray, "c 2"]

    @property
    def rms_px(self) -> float:
        """Root mean square of the residuals in both images."""
        return rms(np.concatenate((self.residual_left_px, self.residual_right_px)))


def checked(view: View, board: Board, calibration: StereoCalibration) -> Checked:
    """A calibration on a view that it was not made from."""
    R_l, R_r, P_l, P_r = rectifying(calibration)
    left = undistorted(view.left, calibration.K_left, calibration.distortion_left, R_l, P_l)
    right = undistorted(view.right, calibration.K_right, calibration.distortion_right, R_r, P_r)
    points = _triangulated(left, right, P_l, P_r)
    at = np.full(len(board.points), -1)
    at[view.number] = np.arange(len(view.number))
    ends = at[board.neighbours]
    ends = ends[(ends >= 0).all(axis=1)]
    sides = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1) / board.square
    residuals = residuals_px(calibration, view, board, standing(view, board, calibration))
    return Checked(view, left[:, 1] - right[:, 1], sides, _size(points, board.points[view.number]), *residuals)


def held_out(
    views: tuple[View, ...], board: Board, image_size: tuple[int, int], metres_per_unit: float | None
) -> tuple[Checked, ...]:
    """Each view checked by a calibration made from the others, in parts of which each is held out once."""
    folds = min(FOLDS, len(views))
    found: list[Checked] = []
    for fold in range(folds):
        rest = tuple(view for index, view in enumerate(views) if index % folds != fold)
        if len(rest) < FEWEST_VIEWS:
            return ()
        calibration = estimated(rest, board, image_size, metres_per_unit).calibration
        found += [checked(view, board, calibration) for view in views[fold::folds]]
    return tuple(found)


def standing(view: View, board: Board, calibration: StereoCalibration) -> Float64[np.ndarray, "4 4"]:
    """How the board stands before the left camera, by both images: T_left_board."""
    on_board = board.points[view.number]
    _, turned, moved = cv2.solvePnP(
        on_board, view.left, np.array(calibration.K_left), np.array(calibration.distortion_left)
    )
    start = np.concatenate((np.asarray(turned).ravel(), np.asarray(moved).ravel()))

    def residual(pose: Float64[np.ndarray, "6"]) -> Float64[np.ndarray, "r"]:
        left, right = residuals_px(calibration, view, board, transform(exp_so3(pose[:3]), pose[3:]))
        return np.concatenate((left.ravel(), right.ravel()))

    pose = least_squares(residual, start, x_scale="jac", max_nfev=30).x
    return transform(exp_so3(pose[:3]), pose[3:])


def rotation_deg(T: Float64[np.ndarray, "4 4"]) -> float:
    """By how much a transform turns."""
    return float(np.degrees(np.linalg.norm(log_so3(T[:3, :3]))))


def _triangulated(
    left: Float64[np.ndarray, "c 2"], right: Float64[np.ndarray, "c 2"], P_l: np.ndarray, P_r: np.ndarray
) -> Float64[np.ndarray, "c 3"]:
    homogeneous = np.asarray(cv2.triangulatePoints(P_l, P_r, left.T, right.T), np.float64)
    return (homogeneous[:3] / homogeneous[3]).T


def _size(points: Float64[np.ndarray, "c 3"], on_board: Float64[np.ndarray, "c 3"]) -> float:
    """The scale of the similarity that brings the board onto the triangulated corners (Umeyama 1991)."""
    seen, true = points - points.mean(axis=0), on_board - on_board.mean(axis=0)
    return float(np.linalg.svd(seen.T @ true, compute_uv=False).sum() / np.sum(true**2))
