"""The two eyes of a stereo camera as they are: pinholes with distortion, turned and apart, or a rectified pair.

Points are in the left eye's frame and in mm; integer pixel coordinates are pixel centres.
"""

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from schemas.messages import RectifiedStereo, StereoCalibration
from shared.camera import camera_matrix, is_rectified
from shared.rendering.render import SceneError

MM_PER_METRE = 1000.0
WIDEST = 4.0
"""No pinhole sees further aside than this many focal lengths; distortion that asks for more is none of an endoscope."""


@dataclass(frozen=True)
class Eye:
    """One camera: size, pinhole, OpenCV's distortion, and where points of the left eye lie in its own frame."""

    width: int
    height: int
    K: Float64[np.ndarray, "3 3"]
    distortion: Float64[np.ndarray, "d"] = field(default_factory=lambda: np.zeros(0))
    R_eye_left: Float64[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    t_eye_left: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))

    @property
    def focal_px(self) -> float:
        """The mean of both focal lengths."""
        return 0.5 * float(self.K[0, 0] + self.K[1, 1])

    @property
    def is_plain(self) -> bool:
        """Whether it is a pinhole with square pixels and its axis through the middle, which Mitsuba draws itself."""
        middle = (0.5 * (self.width - 1), 0.5 * (self.height - 1))
        square = np.isclose(self.K[0, 0], self.K[1, 1], rtol=1e-9) and self.K[0, 1] == 0
        return bool(square and np.allclose(self.K[:2, 2], middle, atol=1e-9) and not self.distortion.any())

    def seen_from(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """Points in this eye's own frame."""
        return points @ self.R_eye_left.T + self.t_eye_left

    def project(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Pixels of points, distortion included."""
        own = self.seen_from(points)
        if not self.distortion.any():
            pixels = own[:, :2] / own[:, 2:]
            return pixels @ self.K[:2, :2].T + self.K[:2, 2]
        none = np.zeros(3)
        return np.asarray(cv2.projectPoints(own, none, none, self.K, self.distortion)[0])[:, 0]

    @cached_property
    def ray_slopes(self) -> Float32[np.ndarray, "h w 2"]:
        """x/z and y/z of the ray of every pixel."""
        v, u = np.indices((self.height, self.width), dtype=np.float64)
        pixels = np.dstack((u, v)).reshape(-1, 1, 2)
        distortion = self.distortion if len(self.distortion) else np.zeros(5)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-8)
        slopes = cv2.undistortPoints(pixels, self.K, distortion, criteria=criteria)
        return np.asarray(slopes, dtype=np.float32).reshape(self.height, self.width, 2)


@dataclass(frozen=True)
class Rig:
    """Both eyes; a rectified camera much like them, by which scenes are arranged; and one that sees all they see."""

    eyes: tuple[Eye, Eye]
    near_enough: RectifiedStereo
    widest: RectifiedStereo

    @property
    def baseline_mm(self) -> float:
        """How far the eyes are apart."""
        return float(np.linalg.norm(self.eyes[1].t_eye_left))

    @property
    def is_rectified(self) -> bool:
        """Whether rows of both images are the same and only the baseline parts them."""
        left, right = self.eyes
        same = np.array_equal(left.K, right.K) and np.array_equal(right.R_eye_left, np.eye(3))
        return bool(same and not right.t_eye_left[1:].any() and not (left.distortion.any() or right.distortion.any()))


def rectified_rig(camera: RectifiedStereo) -> Rig:
    """The eyes of a rectified camera, lengths in mm."""
    size = (camera.image_width, camera.image_height, camera_matrix(camera))
    return Rig((Eye(*size), Eye(*size, t_eye_left=np.array([-camera.baseline, 0.0, 0.0]))), camera, camera)


def calibrated_rig(calibration: StereoCalibration) -> Rig:
    """The eyes of a calibrated camera, before any rectification.

    Raises:
        SceneError: where the calibration does not know its unit, or is none of an endoscope.
    """
    if calibration.metres_per_unit is None:
        raise SceneError("the calibration does not say its unit; give --unit, as in --unit mm")
    to_mm = MM_PER_METRE * calibration.metres_per_unit
    size = (calibration.image_width, calibration.image_height)
    T = calibration.T_right_left
    R = np.eye(3) if is_rectified(calibration) else T[:3, :3]
    left = Eye(*size, calibration.K_left, calibration.distortion_left)
    right = Eye(*size, calibration.K_right, calibration.distortion_right, R, to_mm * T[:3, 3])
    for eye in (left, right):
        widest = float(np.abs(eye.ray_slopes).max())
        if not widest < WIDEST:
            raise SceneError(
                f"the calibration's distortion spreads rays to a slope of {widest:.1f}; check its coefficients"
            )
    K, baseline = calibration.K_left, float(np.linalg.norm(right.t_eye_left))
    near_enough = RectifiedStereo(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], baseline, 1e-3)
    return Rig((left, right), near_enough, _seeing_all(left, right, near_enough))


def _seeing_all(left: Eye, right: Eye, like: RectifiedStereo) -> RectifiedStereo:
    slopes = [np.dstack((eye.ray_slopes, np.ones((eye.height, eye.width)))) @ eye.R_eye_left for eye in (left, right)]
    aside, down = np.max([np.abs(rays[..., :2] / rays[..., 2:]).max(axis=(0, 1)) for rays in slopes], axis=0)
    middle = (0.5 * (like.image_width - 1), 0.5 * (like.image_height - 1))
    focal = (0.5 * like.image_width / aside, 0.5 * like.image_height / down)
    return RectifiedStereo(like.image_width, like.image_height, *focal, *middle, like.baseline, like.metres_per_unit)
