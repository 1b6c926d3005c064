"""The runs of a scene: what it is handed over with, beyond the truth about it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from benchmarks.scenes import BOARD, CLEAR, HIDDEN, Pair, Scene
from schemas.messages import StereoCalibration

NONE, BINARY = "none", "binary"
SEGMENTED = 128
FOCAL_SHARE, ROWS_PX, TURN_DEG = 1e-3, 0.3, 0.1
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Run:
    """A scene with the masks and the calibration to be used for it.

    Fields:
        masks: None where the images have to be segmented.
        masks_are: `none` then, otherwise where they come from.
        calibration_is: what is wrong with the calibration, empty where nothing is.
        R_rectified_camera: how that turns the frame of the result against the frame of the truth.
    """

    scene: Scene
    masks: Pair | None
    masks_are: str
    calibration: StereoCalibration
    calibration_is: str = ""
    R_rectified_camera: Float64[np.ndarray, "3 3"] | None = None


def runs(scene: Scene) -> Iterator[Run]:
    """Every way in which a scene is run."""
    if scene.group not in (HIDDEN, BOARD):
        yield Run(scene, None, NONE, scene.calibration)
    if scene.masks is None:
        return
    yield Run(scene, scene.masks, scene.masks_are, scene.calibration)
    if scene.group != CLEAR:
        return
    binary = [np.where(mask >= SEGMENTED, 255, 0).astype(np.uint8) for mask in scene.masks]
    yield Run(scene, (binary[0], binary[1]), BINARY, scene.calibration)
    for name, wrong in wrong_calibrations(scene.calibration):
        yield Run(scene, scene.masks, scene.masks_are, wrong, name, _turn_of_left(wrong))


def wrong_calibrations(calibration: StereoCalibration) -> Iterator[tuple[str, StereoCalibration]]:
    """The calibration with one error each, of the size that a careful calibration still has."""
    calibration = replace(calibration, covariance=None)
    focal = np.diag([1.0 + FOCAL_SHARE, 1.0 + FOCAL_SHARE, 1.0])
    # K diag(k, k, 1) scales the focal lengths and leaves the principal point
    yield "f 0.1 %", replace(calibration, K_left=calibration.K_left @ focal, K_right=calibration.K_right @ focal)
    rows = np.array(calibration.K_right)
    rows[1, 2] += ROWS_PX
    yield "rows 0.3 px", replace(calibration, K_right=rows)
    for axis, direction in AXES.items():
        turned = np.array(calibration.T_right_left)
        turned[:3, :3] = cv2.Rodrigues(np.radians(TURN_DEG) * np.array(direction))[0] @ turned[:3, :3]
        yield f"{axis} 0.1°", replace(calibration, T_right_left=turned)


def _turn_of_left(calibration: StereoCalibration) -> Float64[np.ndarray, "3 3"]:
    """How rectification turns the left camera: R_rectified_left, by the same OpenCV call as in the pipeline."""
    distortion = [
        np.array(d) if len(d) else np.zeros(5) for d in (calibration.distortion_left, calibration.distortion_right)
    ]
    size = (calibration.image_width, calibration.image_height)
    R, t = np.array(calibration.T_right_left[:3, :3]), calibration.T_right_left[:3, 3:].copy()
    K_left, K_right = np.array(calibration.K_left), np.array(calibration.K_right)
    return np.asarray(cv2.stereoRectify(K_left, distortion[0], K_right, distortion[1], size, R, t, alpha=-1)[0])
