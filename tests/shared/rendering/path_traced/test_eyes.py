"""Eyes as they are: what is traced through a lens lies where its projection says."""

import cv2
import numpy as np
import pytest

from schemas.messages import StereoCalibration
from shared.rendering.path_traced.eyes import calibrated_rig
from shared.rendering.render import SceneError


def calibration(metres_per_unit: float | None = 1e-3):
    distortion = (-0.25, 0.12, 1e-3, -5e-4, 0.0)
    K = np.array([[330.0, 0.0, 165.0], [0.0, 334.0, 84.0], [0.0, 0.0, 1.0]])
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.004, -0.02, 0.006]))[0]
    T[:3, 3] = (-5.1, 0.1, 0.05)
    right = K + np.array([[2.0, 0.0, -4.0], [0.0, 2.0, 3.0], [0.0, 0.0, 0.0]])
    return StereoCalibration(320, 180, K, right, np.array(distortion), 0.9 * np.array(distortion), T, metres_per_unit)


def test_rays_of_pixels_lead_back_to_them_given_a_unit():
    for eye in calibrated_rig(calibration()).eyes:
        slopes = eye.ray_slopes[10::30, 10::30].reshape(-1, 2).astype(np.float64)
        points = np.column_stack((slopes, np.ones(len(slopes)))) * 90.0
        in_left = (points - eye.t_eye_left) @ eye.R_eye_left
        v, u = np.indices((180, 320))[:, 10::30, 10::30].reshape(2, -1)
        np.testing.assert_allclose(eye.project(in_left), np.column_stack((u, v)), atol=1e-3)
    with pytest.raises(SceneError, match="--unit"):
        calibrated_rig(calibration(metres_per_unit=None))
