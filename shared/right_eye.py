"""A right eye that is out of line with the left one: pixels and images between as it came and in line.

The right image of a rectified pair shares its rows with the left one. Where the camera was knocked since it was
calibrated, what lies at (x, y) of an image in line is found in the image as it came at

    (u, v) = c + m R(θ) ((x, y + t) − c),

turned by θ about the principal point c, magnified by m, and t rows lower (`RightEye`).
"""

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from schemas.messages import RectifiedStereo, RightEye, ThreadObservations

Affine = Float64[np.ndarray, "2 3"]
IN_LINE: Affine = np.eye(2, 3)
"""Of an image that is in line as it came."""


def right_eye_of(observations: ThreadObservations) -> RightEye | None:
    """How the right eye lay in that frame; None where in line. Older recordings know whole rows alone."""
    if observations.right_eye is None and observations.rows_moved_up:
        return RightEye(float(observations.rows_moved_up), 0.0, 1.0)
    return observations.right_eye


def whole_rows(eye: RightEye | None) -> int:
    """By how many rows the right eye is lower, where that is all; 0 where it is not."""
    return round(eye.rows_px) if eye is not None and is_rows_alone(eye) else 0


def is_rows_alone(eye: RightEye) -> bool:
    """Whether whole rows are all that it is out of line by, which moves without a blur."""
    return eye.turned_deg == 0 and eye.magnified == 1 and eye.rows_px == round(eye.rows_px)


def from_in_line(eye: RightEye | None, camera: RectifiedStereo) -> Affine:
    """The affine map from pixels (x, y) in line to pixels (u, v) of the image as it came."""
    if eye is None:
        return IN_LINE
    angle, centre = np.radians(eye.turned_deg), np.array([camera.cx_px, camera.cy_px])
    turn = eye.magnified * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack((turn, centre + turn @ (np.array([0.0, eye.rows_px]) - centre)))


def moved(points_px: Float64[np.ndarray, "... 2"], by: Affine) -> Float64[np.ndarray, "... 2"]:
    """Pixels (u, v) after an affine map."""
    return points_px @ by[:, :2].T + by[:, 2]


def in_line(
    image: UInt8[np.ndarray, "h w *c"], eye: RightEye | None, camera: RectifiedStereo, linear: bool = False
) -> UInt8[np.ndarray, "h w *c"]:
    """The right image put in line with the left one, its borders repeated.

    Args:
        linear: by linear interpolation, as masks are; cubic, if not.
    """
    if eye is None:
        return image
    if is_rows_alone(eye):
        return image[np.clip(np.arange(len(image)) + round(eye.rows_px), 0, len(image) - 1)]
    how = cv2.WARP_INVERSE_MAP | (cv2.INTER_LINEAR if linear else cv2.INTER_CUBIC)
    size = image.shape[1], image.shape[0]
    put = cv2.warpAffine(image, from_in_line(eye, camera), size, flags=how, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(put, np.uint8)
