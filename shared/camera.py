"""Projection into a rectified stereo pair, and back.

    u_left = fx x / z + cx     u_right = u_left − fx b / z     v = fy y / z + cy

with b the baseline, so that disparity δ = u_left − u_right = fx b / z. Integer coordinates are pixel centres.
"""

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo, StereoCalibration


def camera_matrix(camera: RectifiedStereo) -> Float64[np.ndarray, "3 3"]:
    """The pinhole matrix that both rectified cameras share."""
    return np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])


def is_rectified(calibration: StereoCalibration) -> bool:
    """Whether images of this camera need no resampling: one pinhole matrix, no distortion, a shift along x alone."""
    R, t = calibration.T_right_left[:3, :3], calibration.T_right_left[:3, 3]
    same_camera = np.allclose(calibration.K_left, calibration.K_right, rtol=1e-9, atol=0.0)
    no_skew = calibration.K_left[0, 1] == 0
    undistorted = not calibration.distortion_left.any() and not calibration.distortion_right.any()
    parallel = np.allclose(R, np.eye(3), rtol=0.0, atol=1e-9) and np.allclose(t[1:], 0.0, atol=1e-9 * abs(t[0]))
    return bool(same_camera and no_skew and undistorted and parallel)


def project(
    camera: RectifiedStereo, points_camera: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]:
    """Pixels (u, v) of points in the left and in the right image; points must lie in front of the camera."""
    x, y, z = points_camera.T
    u = camera.fx_px * x / z + camera.cx_px
    v = camera.fy_px * y / z + camera.cy_px
    return np.column_stack((u, v)), np.column_stack((u - camera.fx_px * camera.baseline / z, v))


def depth_of_disparity(camera: RectifiedStereo, disparity_px: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """Depth of matched pixels in the calibration's unit; disparities must be positive."""
    return camera.fx_px * camera.baseline / disparity_px


def backproject(
    camera: RectifiedStereo, left_px: Float64[np.ndarray, "n 2"], depth: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n 3"]:
    """Points in the camera frame from left pixels (u, v) and depths."""
    x = (left_px[:, 0] - camera.cx_px) * depth / camera.fx_px
    y = (left_px[:, 1] - camera.cy_px) * depth / camera.fy_px
    return np.column_stack((x, y, depth))
