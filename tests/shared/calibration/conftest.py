import numpy as np
import pytest

from schemas.messages import StereoCalibration
from shared.rigid_transforms import exp_so3, transform


@pytest.fixture(scope="session")
def endoscope() -> StereoCalibration:
    """A plausible stereo endoscope in millimetres, with nothing symmetric about it."""
    return StereoCalibration(
        image_width=960,
        image_height=540,
        K_left=np.array([[811.5, 0, 398.7], [0, 812.25, 288.1], [0, 0, 1]]),
        K_right=np.array([[810.1, 0, 539.7], [0, 810.6, 283.6], [0, 0, 1]]),
        distortion_left=np.array([-0.43, 0.24, -0.0037, 0.002, -0.08]),
        distortion_right=np.array([-0.41, 0.28, -0.0026, 0.0002, -0.14]),
        T_right_left=transform(exp_so3(np.array([0.005, -0.018, 0.003])), np.array([-5.6, 0.06, -0.14])),
        metres_per_unit=1e-3,
    )
