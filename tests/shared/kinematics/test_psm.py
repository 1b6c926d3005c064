import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from shared.kinematics.psm import (
    JOINT_NAMES,
    LARGE_NEEDLE_DRIVER,
    Problem,
    Psm,
    describe,
    forward,
    inverse,
    joint_problem,
)
from shared.rigid_transforms import transform

OF_SI = {2: -0.4826, 3: 0.4670}
SI = dataclasses.replace(
    LARGE_NEEDLE_DRIVER,
    links=tuple(link._replace(d=OF_SI.get(i, link.d)) for i, link in enumerate(LARGE_NEEDLE_DRIVER.links)),
)
STRAIGHT = np.array((0.0, 0.0, 0.12, 0.0, 0.0, 0.0))


def random_joints(count: int, seed: int, psm: Psm = LARGE_NEEDLE_DRIVER) -> np.ndarray:
    """Within all limits, the remote centre's included."""
    lower, upper = psm.limits.T
    lower = lower.copy()
    lower[2] = psm.shaft_clearance - psm.shaft_offset
    return np.random.default_rng(seed).uniform(lower, upper, (count, 6))


def product_of_exponentials(joints: np.ndarray) -> np.ndarray:
    """The arm by its axes when all joints are 0, from its drawing instead of from its table.

    The shaft points along -z of the base; it ends 15.6 mm short of the remote centre, and the pin is 9.1 mm further.
    """
    shaft_end, pin = np.array((0, 0, 0.0156)), np.array((0, 0, 0.0156 - 0.0091))
    origin = np.zeros(3)
    axes = (
        ((0, -1, 0), origin),
        ((-1, 0, 0), origin),
        None,
        ((0, 0, -1), origin),
        ((-1, 0, 0), shaft_end),
        ((0, -1, 0), pin),
    )
    exponentials = []
    for value, axis in zip(joints, axes, strict=True):
        twist = np.zeros((4, 4))
        if axis is None:
            twist[:3, 3] = (0, 0, -1)
        else:
            direction, point = np.array(axis[0], float), axis[1]
            twist[:3, :3], twist[:3, 3] = np.cross(np.eye(3), direction), -np.cross(direction, point)
        exponentials.append(expm(value * twist))
    home = transform(np.array(((0.0, 1, 0), (1, 0, 0), (0, 0, -1))), pin)
    return np.linalg.multi_dot((*exponentials, home))


def test_forward_agrees_with_the_published_value_and_the_product_of_exponentials_of_the_arms_axes():
    np.testing.assert_allclose(forward(STRAIGHT)[:3, 3], (0, 0, -0.1135), atol=1e-15)
    joints = random_joints(20, seed=1)
    expected = np.stack([product_of_exponentials(row) for row in joints])
    np.testing.assert_allclose(forward(joints), expected, atol=1e-14)


@pytest.mark.parametrize("psm", [LARGE_NEEDLE_DRIVER, SI], ids=["classic", "si"])
def test_inverse_of_forward_returns_the_joints_of_random_poses(psm):
    joints = random_joints(2_000, seed=2, psm=psm)
    T_base_tool = forward(joints, psm)
    solution = inverse(T_base_tool, psm)
    assert not solution.problem.any()
    apart = solution.joints - joints
    # whole turns of the roll left out
    apart[:, 3] = np.remainder(apart[:, 3] + np.pi, 2 * np.pi) - np.pi
    assert np.abs(apart).max() < 1e-12
    assert np.abs(forward(solution.joints, psm) - T_base_tool).max() < 1e-12


@given(
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 1e-3),
    st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3),
)
def test_a_pose_has_joints_that_reach_it_or_a_problem(quaternion, place):
    T = transform(Rotation.from_quat(quaternion).as_matrix(), np.array(place))
    solution = inverse(T)
    if solution.problem == Problem.NONE:
        np.testing.assert_allclose(forward(solution.joints), T, atol=1e-11)
        assert joint_problem(solution.joints) == Problem.NONE
    elif np.isfinite(solution.joints).all() and solution.problem >= Problem.YAW:
        assert joint_problem(solution.joints) != Problem.NONE


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=16, max_size=16))
def test_any_sixteen_numbers_give_an_answer(numbers):
    solution = inverse(np.array(numbers).reshape(4, 4))
    assert solution.problem != Problem.NONE or np.isfinite(solution.joints).all()


def test_numbers_that_are_no_pose_and_a_pose_that_no_wrist_reaches_are_told_apart():
    poses = np.repeat(forward(STRAIGHT)[None], 5, axis=0)
    poses[0, 0, 3] = np.nan
    poses[1, :3, :3] *= 1.001
    poses[2, :3, 0] *= -1
    poses[3, 3, 0] = 0.1
    expected = (Problem.NOT_FINITE, *(Problem.NO_ROTATION,) * 3, Problem.NONE)
    np.testing.assert_array_equal(inverse(poses).problem, expected)
    # a pin that points at the remote centre
    R = np.array(((0.0, 1, 0), (0, 0, 1), (1, 0, 0)))
    solution = inverse(transform(R, np.array((0, 0, -0.15))))
    assert solution.problem == Problem.WRIST_FOLDED
    assert np.isnan(solution.joints).all()


def test_a_shaft_that_ends_less_than_45_mm_beyond_the_remote_centre_or_is_no_number_is_refused():
    joints = np.stack((STRAIGHT, STRAIGHT))
    joints[:, 2] = np.array((0.0449, 0.0451)) + 0.0156
    np.testing.assert_array_equal(inverse(forward(joints)).problem, (Problem.REMOTE_CENTRE, Problem.NONE))
    assert "44.9 mm beyond the remote centre" in describe(Problem(int(joint_problem(joints[0]))), joints[0])
    joints[1, 4] = np.nan
    assert joint_problem(joints[1]) == Problem.NOT_FINITE
    assert describe(Problem.NOT_FINITE, joints[1]) == "a number of it is not finite"


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("side", [0, 1])
def test_each_joint_is_refused_beyond_its_limit_and_named(joint, side):
    joints = np.stack((STRAIGHT, STRAIGHT))
    limit = LARGE_NEEDLE_DRIVER.limits[joint, side]
    joints[1, joint] = limit + (1e-3 if side else -1e-3)
    if (joint, side) == (2, 0):
        assert joint_problem(joints)[1] == Problem.REMOTE_CENTRE
        return
    joints[0, joint] = limit
    np.testing.assert_array_equal(joint_problem(joints), (Problem.NONE, Problem.YAW + joint))
    assert f"the {JOINT_NAMES[joint]} joint" in describe(Problem(Problem.YAW + joint), joints[1])
