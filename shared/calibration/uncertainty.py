"""What a stereo calibration may be off by, and how far that moves what is measured with it.

Eight errors of a rectified pair, each what the calibration says less what is true, change the place of a point in
first order. With the ray x = (u - c_x) / f, y likewise, and the right eye's x_r = x - b / Z, a rotation ω of the right
eye moves x_r by

    δx_r = ω_y (1 + x_r²) - ω_z y - ω_x x_r y,

another focal length of it by ε x_r, and depth follows from Z = b / (x - x_r). What they do to rows is not in it: that
is seen in the images, and reconstruction estimates it under the same covariance.

A robot whose hand-eye transform was found through the same camera is off by the same motion as the thread. So a rigid
motion of the whole field cancels, and what bends or stretches the field is left.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo, StereoCalibration
from shared.camera import backproject

ERRORS = "pitch", "vergence", "roll", "focal", "focal_apart", "baseline", "cx", "cy"
"""ω_x, ω_y, ω_z of the right eye in radians; δf / f of both eyes; that of the right eye beside it; δb / b; the
principal point of both eyes, as a share of the focal length."""
USUAL = np.array([3e-4, 3e-4, 5e-4, 2e-3, 5e-4, 1e-3, 2e-3, 2e-3])
"""Deviations where a file states none. Rows of calibrated rigs lie some 0.3 px of 1000 apart, and nothing shows the
same error along the rows; at the rim, where perception puts an eye in line that is off by 0.75 px, half as much again.
The others are about those of twenty views of a board whose corners are seen to 0.3 px."""
FIELD_DEPTHS, FIELD_SHARES = (0.8, 1.0, 1.2), (0.2, 0.35, 0.5, 0.65, 0.8)
"""Of the thread's distance, and of the image's sides: where a hand-eye calibration is taken to have been made."""


def usual_covariance() -> Float64[np.ndarray, "8 8"]:
    """Of the errors of a calibration that states none."""
    return np.diag(USUAL**2)


def covariance_of(calibration: StereoCalibration) -> Float64[np.ndarray, "8 8"]:
    """Of a calibration's errors: as it states, or what is usual where it states none."""
    return usual_covariance() if calibration.covariance is None else calibration.covariance


def displacements(camera: RectifiedStereo, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 8"]:
    """How far each error moves each point of the left camera frame, per unit of the error."""
    X, Y, Z = points.T
    x, y, right = X / Z, Y / Z, (X - camera.baseline) / Z
    nothing = np.zeros_like(Z)
    moved_right = np.stack((-right * y, 1.0 + right**2, -y, nothing, right, nothing, nothing, nothing), axis=1)
    depth = moved_right * (Z**2 / camera.baseline)[:, None]
    depth[:, 3] += Z
    depth[:, 5] += Z
    moved = depth[:, None] * np.stack((x, y, np.ones_like(Z)), axis=1)[:, :, None]
    moved[:, :2, 3] -= np.stack((X, Y), axis=1)
    moved[:, 0, 6] -= Z
    moved[:, 1, 7] -= Z
    return moved


def bending(camera: RectifiedStereo, points: Float64[np.ndarray, "n 3"], depth: float) -> Float64[np.ndarray, "n 3 8"]:
    """What is left of the displacements when the rigid motion of the field is taken out that fits each best.

    Args:
        depth: of the middle of the field, of which two digits count.
    """
    middle, motion = _field_motion(camera, float(f"{depth:.2g}"))
    return displacements(camera, points) - (_motions(points - middle) @ motion).reshape(-1, 3, len(ERRORS))


@lru_cache(maxsize=64)
def _field_motion(camera: RectifiedStereo, depth: float) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "6 8"]]:
    """The motion of the field about its middle that fits the displacements of each error best."""
    field, middle = field_of(camera, depth), np.array((0.0, 0.0, depth))
    of_field = displacements(camera, field).reshape(-1, len(ERRORS))
    return middle, np.linalg.lstsq(_motions(field - middle), of_field, rcond=None)[0]


def field_of(camera: RectifiedStereo, depth: float) -> Float64[np.ndarray, "f 3"]:
    """Places all over the field about a depth, where a hand-eye calibration is taken to have been made."""
    u, v = np.meshgrid(*(np.array(FIELD_SHARES) * (size - 1.0) for size in (camera.image_width, camera.image_height)))
    pixels = np.column_stack((u.ravel(), v.ravel()))
    return np.concatenate([backproject(camera, pixels, np.full(len(pixels), share * depth)) for share in FIELD_DEPTHS])


def _motions(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m 6"]:
    """How a shift along each axis and a turn about it move points, one coordinate after the other."""
    moved = np.zeros((len(points), 3, 6))
    moved[:, :, :3] = np.eye(3)
    x, y, z = points.T
    # e_axis × point
    moved[:, 1, 3], moved[:, 2, 3] = -z, y
    moved[:, 0, 4], moved[:, 2, 4] = z, -x
    moved[:, 0, 5], moved[:, 1, 5] = -y, x
    return moved.reshape(-1, 6)
