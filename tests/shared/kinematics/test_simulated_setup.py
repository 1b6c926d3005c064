import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shared.kinematics.psm import Problem, forward
from shared.kinematics.psm import inverse as inverse_kinematics
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import inverse, orthonormality_error, transform

HALF_FINGER_M = 0.0051


def grasps_over_the_field_of_view() -> np.ndarray:
    """`T_camera_tool` with fingers up to 45° from the optical axis, any way round, the thread half a finger on."""
    places = itertools.product(np.linspace(-0.48, 0.48, 7), np.linspace(-0.27, 0.27, 5), np.linspace(0.070, 0.115, 4))
    points = np.array([(x * z, y * z, z) for x, y, z in places])
    towards = [(0.0, 0.0), *itertools.product(np.radians((22, 45)), np.radians(range(0, 360, 30)))]
    rolled = itertools.product(towards, np.radians(range(0, 360, 30)))
    angles = [(azimuth, tilt, roll - azimuth) for (tilt, azimuth), roll in rolled]
    turns = Rotation.from_euler("ZYZ", angles).as_matrix()
    R = np.broadcast_to(turns, (len(points), *turns.shape)).reshape(-1, 3, 3)
    return transform(R, np.repeat(points, len(turns), axis=0) - HALF_FINGER_M * R[:, :, 2])


def test_the_second_arm_is_the_mirror_image_of_the_first():
    mirror = np.diag([-1.0, 1, 1, 1])
    np.testing.assert_allclose(SIMULATED_BASES["psm2"], mirror @ SIMULATED_BASES["psm1"] @ mirror, atol=1e-15)


@pytest.mark.parametrize("T_camera_base", SIMULATED_BASES.values(), ids=SIMULATED_BASES)
def test_every_grasp_over_the_field_of_view_can_be_reached(T_camera_base):
    assert orthonormality_error(T_camera_base[:3, :3]) < 1e-15
    assert np.linalg.det(T_camera_base[:3, :3]) > 0
    T_camera_tool = grasps_over_the_field_of_view()
    assert np.degrees(np.arccos(T_camera_tool[:, 2, 2].min())) > 44.9
    solution = inverse_kinematics(inverse(T_camera_base) @ T_camera_tool)
    assert (solution.problem == Problem.NONE).all()
    np.testing.assert_allclose(T_camera_base @ forward(solution.joints), T_camera_tool, atol=1e-12)
