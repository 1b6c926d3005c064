"""Both images of a frame, decoded and rectified: resampled so that matching pixels lie on one row (stereoRectify)."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from schemas.messages import Image, RectifiedStereo, RightEye, StereoCalibration, StereoFrame
from shared.camera import is_rectified
from shared.images import decode_image
from shared.in_parallel import of_both
from shared.right_eye import in_line

Pair = tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]


class RectificationError(ValueError):
    """A calibration that cannot be rectified; the text names the remedy."""


@dataclass(frozen=True)
class Rectification:
    """The rectified camera and, unless the images already are rectified, the maps that make them so."""

    camera: RectifiedStereo
    map_left: Float32[np.ndarray, "h w 2"] | None
    map_right: Float32[np.ndarray, "h w 2"] | None


@dataclass(frozen=True)
class RectifiedPair:
    """A pair of images in colour.

    Fields:
        images: rectified.
        raw: as the camera gave them.
    """

    camera: RectifiedStereo
    images: Pair
    raw: Pair

    def in_line(self, eye: RightEye | None) -> "RectifiedPair":
        """The pair with a right eye put in line that is out of it by so much."""
        return replace(self, images=(self.images[0], in_line(self.images[1], eye, self.camera))) if eye else self


def rectification(calibration: StereoCalibration) -> Rectification:
    """What takes raw images of this camera to rectified ones of the same size.

    Raises:
        RectificationError: where the right camera does not sit to the right of the left one, or the cameras share no
            view.
    """
    t = calibration.T_right_left[:3, 3]
    if -t[0] < np.abs(t[1:]).max():
        raise RectificationError(
            "the calibration does not put the right camera to the right of the left one; exchange the cameras, or "
            "invert the transform if it maps right to left"
        )
    if is_rectified(calibration):
        return Rectification(rectified_camera(calibration, calibration.K_left, -float(t[0])), None, None)
    size = (calibration.image_width, calibration.image_height)
    K_l, K_r = np.array(calibration.K_left), np.array(calibration.K_right)
    d_l, d_r = _coefficients(calibration.distortion_left), _coefficients(calibration.distortion_right)
    R_l, R_r, P_l, P_r, *_ = cv2.stereoRectify(
        K_l, d_l, K_r, d_r, size, np.array(calibration.T_right_left[:3, :3]), t[:, None].copy(), alpha=-1
    )
    K, shift = np.asarray(P_l)[:, :3], float(np.asarray(P_r)[0, 3])
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0 and shift < 0):
        raise RectificationError(
            "the calibration leaves no common view to rectify to; check its distortion coefficients and its rotation"
        )
    map_left, _ = cv2.initUndistortRectifyMap(K_l, d_l, R_l, K, size, cv2.CV_32FC2)
    map_right, _ = cv2.initUndistortRectifyMap(K_r, d_r, R_r, K, size, cv2.CV_32FC2)
    return Rectification(rectified_camera(calibration, K, -shift / float(K[0, 0])), map_left, map_right)


def rectify_image(image: UInt8[np.ndarray, "h w *c"], map_px: Float32[np.ndarray, "h w 2"] | None) -> np.ndarray:
    """The image resampled by cubic interpolation, borders repeated; the image itself where there is no map."""
    if map_px is None:
        return image
    return _remap(image, map_px, cv2.INTER_CUBIC, cv2.BORDER_REPLICATE)


def rectify_mask(mask: UInt8[np.ndarray, "h w"], map_px: Float32[np.ndarray, "h w 2"] | None) -> np.ndarray:
    """The coverage mask resampled linearly, nothing beyond its borders; the mask itself where there is no map."""
    if map_px is None:
        return mask
    return _remap(mask, map_px, cv2.INTER_LINEAR, cv2.BORDER_CONSTANT)


def _remap(image: np.ndarray, map_px: np.ndarray, interpolation: int, border: int) -> np.ndarray:
    # OpenCV's stub knows no absent second map, and an empty array in its place reads beyond memory (OpenCV 5.0)
    return cv2.remap(image, map_px, None, interpolation, borderMode=border)  # pyright: ignore[reportCallIssue, reportArgumentType]


def _coefficients(distortion: np.ndarray) -> np.ndarray:
    return np.array(distortion) if len(distortion) else np.zeros(5)


def rectified_camera(calibration: StereoCalibration, K: np.ndarray, baseline: float) -> RectifiedStereo:
    """The camera of rectified images with that pinhole matrix and baseline."""
    return RectifiedStereo(
        image_width=calibration.image_width,
        image_height=calibration.image_height,
        fx_px=float(K[0, 0]),
        fy_px=float(K[1, 1]),
        cx_px=float(K[0, 2]),
        cy_px=float(K[1, 2]),
        baseline=baseline,
        metres_per_unit=calibration.metres_per_unit,
    )


def decoded_pair(frame: StereoFrame) -> Pair:
    """Both images of a frame in colour.

    Raises:
        ImageDataError: where one cannot be decoded.
    """
    return of_both(_decoded, (frame.left,), (frame.right,))


def rectified_pair(raw: Pair, to_rectified: Rectification) -> RectifiedPair:
    """Images of the size that the rectification is for, rectified."""
    left, right = raw
    images = rectify_image(left, to_rectified.map_left), rectify_image(right, to_rectified.map_right)
    return RectifiedPair(to_rectified.camera, images, raw)


def _decoded(image: Image) -> UInt8[np.ndarray, "h w 3"]:
    return _colour(decode_image(image))


def _colour(pixels: Any) -> Any:
    return pixels if pixels.ndim == 3 else pixels[:, :, None].repeat(3, axis=2)
