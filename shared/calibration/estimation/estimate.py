"""The stereo camera whose views of a board these are (Zhang 2000; OpenCV's calibrateCamera and stereoCalibrate).

Each eye is calibrated by itself first. From there both are refined together with the way from one to the other, so
that the reprojection of all corners in both images is closest in least squares. A view that stays further from it than
the others do was seen wrongly, or at two moments by the two eyes: it is named, left out, and the rest estimated again.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from schemas.checks import MessageError
from schemas.messages import StereoCalibration
from shared.calibration.estimation.board import Board
from shared.calibration.estimation.covariance import error_covariance
from shared.calibration.estimation.coverage import View
from shared.calibration.estimation.projection import residuals_px
from shared.calibration.stated import CalibrationError
from shared.rigid_transforms import nearest_rotation, transform

FEWEST_VIEWS = 5
"""Fewer cannot tell lens, focal length and distance apart."""
VIEWS_FOR_ALL = 10
"""With fewer the third radial coefficient stays 0, which few views would make up."""
OUTLIER_RATIO, OUTLIER_PX = 3.0, 0.5
"""A view is left out whose residual is so many times that of the median view, and larger than that."""
NO_CAMERA_SHARE, ONE_PLACE_SHARE = 0.005, 0.001
"""Of the image's width: what no lens leaves of half of the views. Of the board's distance: the least between eyes."""
NO_CAMERA = (
    "these views determine no camera; take more, of the board tilted and at different distances, with neither eye's "
    "image mirrored or turned"
)
MOST_OUTLIERS = 0.3
"""Of the views; where more are far off, nothing tells which are right."""
CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)


@dataclass(frozen=True)
class Estimate:
    """A calibration with what it leaves.

    Fields:
        views: those that it was estimated from.
        T_left_board: of each of them, from the board to the left camera.
        residual_left_px, residual_right_px: of each view, what is left at each corner, seen minus expected.
        left_out: names of views that contradict the others, with the residual of each.
    """

    calibration: StereoCalibration
    views: tuple[View, ...]
    T_left_board: Float64[np.ndarray, "n 4 4"]
    residual_left_px: tuple[Float64[np.ndarray, "c 2"], ...]
    residual_right_px: tuple[Float64[np.ndarray, "c 2"], ...]
    left_out: tuple[tuple[str, float], ...] = ()

    @property
    def view_rms_px(self) -> Float64[np.ndarray, "n"]:
        """Of each view, the root mean square of its residuals in both images."""
        both = zip(self.residual_left_px, self.residual_right_px, strict=True)
        return np.array([rms(np.concatenate(pair)) for pair in both])


def rms(residual_px: Float64[np.ndarray, "n 2"]) -> float:
    """Root mean square of distances."""
    return float(np.sqrt(np.mean(np.sum(residual_px**2, axis=1))))


def estimated(
    views: tuple[View, ...], board: Board, image_size: tuple[int, int], metres_per_unit: float | None
) -> Estimate:
    """The calibration that fits the views, those left out that contradict it.

    Raises:
        CalibrationError: where there are too few views, or they determine no camera.
    """
    left_out: list[tuple[str, float]] = []
    most = int(MOST_OUTLIERS * len(views))
    while True:
        if len(views) < FEWEST_VIEWS:
            raise CalibrationError(_too_few(len(views)))
        found = _fitted(views, board, image_size, metres_per_unit)
        far = found.view_rms_px
        worst = int(np.argmax(far))
        if len(left_out) >= most or far[worst] < max(OUTLIER_PX, OUTLIER_RATIO * float(np.median(far))):
            break
        left_out.append((views[worst].name, float(far[worst])))
        views = views[:worst] + views[worst + 1 :]
    _check_fit(found)
    fixed = () if len(views) >= VIEWS_FOR_ALL else (4,)
    covariance = error_covariance(found.calibration, found.views, board, found.T_left_board, fixed)
    return Estimate(
        replace(found.calibration, covariance=covariance),
        found.views,
        found.T_left_board,
        found.residual_left_px,
        found.residual_right_px,
        tuple(left_out),
    )


def _too_few(count: int) -> str:
    if count == 0:
        return (
            "no pair shows the board to both eyes; check --squares, which counts squares and not corners, --marker, "
            "and that all of the board is in view"
        )
    return (
        f"{count} view{'s are' if count > 1 else ' is'} too few; take at least {FEWEST_VIEWS}, better 20, of the board "
        "at different places, distances and tilts"
    )


def _check_fit(found: Estimate) -> None:
    """Refuse what no stereo camera sees.

    Raises:
        CalibrationError: where the corners of both images fit no camera, or its eyes stand in one place.
    """
    off_px = float(np.median(found.view_rms_px))
    if off_px > NO_CAMERA_SHARE * found.calibration.image_width:
        raise CalibrationError(
            f"the corners of both images fit no camera (half of the views are more than {off_px:.1f} px off); turn off "
            "mirroring and turning of one eye, give both eyes of one moment, and the board that was shown"
        )
    apart = float(np.linalg.norm(found.calibration.T_right_left[:3, 3]))
    if apart < ONE_PLACE_SHARE * float(np.median(found.T_left_board[:, 2, 3])):
        raise CalibrationError(
            "both eyes see every board from one place, as one image given twice does; give the left and the right image"
        )


def _fitted(
    views: tuple[View, ...], board: Board, image_size: tuple[int, int], metres_per_unit: float | None
) -> Estimate:
    on_board = [board.points[view.number].astype(np.float32) for view in views]
    left, right = ([getattr(view, eye).astype(np.float32) for view in views] for eye in ("left", "right"))
    flags = 0 if len(views) >= VIEWS_FOR_ALL else cv2.CALIB_FIX_K3
    try:
        alone = [
            cv2.calibrateCamera(on_board, seen, image_size, np.eye(3), np.zeros(5), flags=flags, criteria=CRITERIA)
            for seen in (left, right)
        ]
        (_, K_l, d_l, *_), (_, K_r, d_r, *_) = alone
        _, K_l, d_l, K_r, d_r, R, t, _, _, turned, moved, _ = cv2.stereoCalibrateExtended(
            on_board,
            left,
            right,
            K_l,
            d_l,
            K_r,
            d_r,
            image_size,
            np.eye(3),
            np.zeros((3, 1)),
            flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS,
            criteria=CRITERIA,
        )
    except cv2.error:
        raise CalibrationError(NO_CAMERA) from None
    T_right_left = transform(nearest_rotation(np.asarray(R)), np.asarray(t).ravel())
    width, height = image_size
    try:
        calibration = StereoCalibration(
            image_width=width,
            image_height=height,
            K_left=np.asarray(K_l),
            K_right=np.asarray(K_r),
            distortion_left=np.asarray(d_l).ravel(),
            distortion_right=np.asarray(d_r).ravel(),
            T_right_left=T_right_left,
            metres_per_unit=metres_per_unit,
        )
    except MessageError:
        raise CalibrationError(NO_CAMERA) from None
    T_left_board = np.array(
        [transform(_rotation(np.asarray(r)), np.asarray(p).ravel()) for r, p in zip(turned, moved, strict=True)]
    )
    residuals = [residuals_px(calibration, view, board, T) for view, T in zip(views, T_left_board, strict=True)]
    return Estimate(calibration, views, T_left_board, tuple(a for a, _ in residuals), tuple(b for _, b in residuals))


def _rotation(vector: Float64[np.ndarray, "3 1"]) -> Float64[np.ndarray, "3 3"]:
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)
