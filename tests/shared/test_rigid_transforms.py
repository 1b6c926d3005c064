import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from shared.rigid_transforms import (
    angle_between,
    apply,
    compose,
    exp_se3,
    exp_so3,
    inverse,
    log_se3,
    log_so3,
    nearest_rotation,
    orthonormality_error,
    quaternion_from_rotation,
    rotation_from_quaternion,
    transform,
)

ANGLES = (0.0, 1e-300, 1e-12, 1e-7, 1e-3, 0.49, 0.51, 1.5, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12)


def rotation_vectors(angle: float) -> np.ndarray:
    """Random axes and the coordinate axes, both ways, scaled to one angle."""
    axes = np.random.default_rng(3).normal(size=(20, 3))
    axes = np.concatenate((axes, np.eye(3), -np.eye(3)))
    return angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)


def twists(angle: float) -> np.ndarray:
    rotation = rotation_vectors(angle)
    return np.concatenate((np.random.default_rng(4).normal(size=rotation.shape), rotation), axis=1)


def twist_matrix(twist: np.ndarray) -> np.ndarray:
    (vx, vy, vz), (x, y, z) = twist[:3], twist[3:]
    return np.array([[0, -z, y, vx], [z, 0, -x, vy], [-y, x, 0, vz], [0, 0, 0, 0]])


finite = st.floats(-10, 10)
random_twists = st.lists(finite, min_size=6, max_size=6).map(np.array)


@pytest.mark.parametrize("angle", ANGLES)
def test_exponential_of_a_rotation_vector_agrees_with_scipy_and_the_logarithm_undoes_it(angle):
    vectors = rotation_vectors(angle)
    np.testing.assert_allclose(exp_so3(vectors), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(log_so3(exp_so3(vectors)), vectors, rtol=1e-9, atol=1e-14)


def test_logarithm_of_a_half_turn_is_a_vector_of_length_pi_that_gives_the_rotation_again():
    rotations = exp_so3(rotation_vectors(np.pi))
    logarithms = log_so3(rotations)
    np.testing.assert_allclose(np.linalg.norm(logarithms, axis=1), np.pi, atol=1e-14)
    np.testing.assert_allclose(exp_so3(logarithms), rotations, atol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_the_angle_between_two_rotations_is_that_of_the_logarithm(angle):
    turned = exp_so3(rotation_vectors(angle))
    other = exp_so3(np.array((0.3, -2.0, 1.1)))
    np.testing.assert_allclose(angle_between(other, other @ turned), angle, rtol=1e-6, atol=1e-15)


def test_logarithm_of_the_identity_is_zero():
    assert not log_so3(np.eye(3)).any()
    assert not log_se3(np.eye(4)).any()


@pytest.mark.parametrize("angle", ANGLES)
def test_exponential_of_a_twist_agrees_with_the_matrix_exponential_and_the_logarithm_undoes_it(angle):
    oracle = np.stack([expm(twist_matrix(twist)) for twist in twists(angle)])
    np.testing.assert_allclose(exp_se3(twists(angle)), oracle, atol=1e-13)
    np.testing.assert_allclose(log_se3(exp_se3(twists(angle))), twists(angle), rtol=1e-9, atol=2e-11)


@settings(max_examples=15)
@given(random_twists, random_twists, random_twists)
def test_transforms_form_a_group(a, b, c):
    A, B, C = exp_se3(np.stack((a, b, c)))
    points = np.random.default_rng(5).normal(size=(7, 3))
    np.testing.assert_allclose(apply(compose(A, B), points), apply(A, apply(B, points)), atol=1e-12)
    np.testing.assert_allclose(compose(compose(A, B), C), compose(A, compose(B, C)), atol=1e-12)
    np.testing.assert_allclose(compose(A, inverse(A)), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(compose(inverse(A), A), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(inverse(compose(A, B)), compose(inverse(B), inverse(A)), atol=1e-12)
    assert (compose(A, np.eye(4)) == A).all()
    assert orthonormality_error(compose(A, B)[:3, :3]) < 1e-13


def test_a_stack_of_transforms_moves_each_its_own_points():
    T = exp_se3(twists(1.0))
    points = np.random.default_rng(6).normal(size=(len(T), 5, 3))
    homogeneous = np.concatenate((points, np.ones((*points.shape[:2], 1))), axis=2)
    oracle = np.stack([(matrix @ rows.T).T[:, :3] for matrix, rows in zip(T, homogeneous, strict=True)])
    np.testing.assert_allclose(apply(T, points), oracle, atol=1e-14)


def test_a_transform_rotates_first_and_moves_then():
    quarter_turn_about_z = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    T = transform(quarter_turn_about_z, np.array([10.0, 20, 30]))
    np.testing.assert_array_equal(apply(T, np.array([[1.0, 0, 0]])), [[10, 21, 30]])


@pytest.mark.parametrize("angle", (*ANGLES, np.pi))
def test_quaternions_agree_with_scipy(angle):
    rotations = Rotation.from_rotvec(rotation_vectors(angle))
    q = quaternion_from_rotation(rotations.as_matrix())
    assert (q[:, 0] >= 0).all()
    oracle = rotations.as_quat(scalar_first=True)
    np.testing.assert_allclose(np.abs((q * oracle).sum(axis=1)), 1, atol=1e-14)
    np.testing.assert_allclose(rotation_from_quaternion(q), rotations.as_matrix(), atol=1e-14)


def test_a_quaternion_may_have_any_length_and_sign_but_not_zero():
    q = np.array([0.3, -0.5, 0.1, 0.8])
    np.testing.assert_allclose(rotation_from_quaternion(-7 * q), rotation_from_quaternion(q), atol=1e-15)
    with pytest.raises(ValueError, match="length zero"):
        rotation_from_quaternion(np.zeros(4))


def test_nearest_rotation_undoes_stretch_and_none_nearby_is_closer():
    R = exp_so3(np.array([0.4, -1.0, 2.0]))
    Q = exp_so3(np.array([1.0, 0.3, 0.2]))
    stretch = Q @ np.diag([0.5, 1.1, 3.0]) @ Q.T
    np.testing.assert_allclose(nearest_rotation(R @ stretch), R, atol=1e-14)
    rng = np.random.default_rng(7)
    matrices = rng.normal(size=(50, 3, 3))
    nearest = nearest_rotation(matrices)
    np.testing.assert_allclose(np.linalg.det(nearest), 1, atol=1e-12)
    moved = nearest @ exp_so3(1e-3 * rng.normal(size=(50, 3)))
    assert (np.linalg.norm(moved - matrices, axis=(1, 2)) >= np.linalg.norm(nearest - matrices, axis=(1, 2))).all()


def test_orthonormality_error_is_the_largest_deviation_from_the_identity():
    assert orthonormality_error(np.eye(3)) == 0
    assert orthonormality_error(np.diag([1.0, 1.0, 1.1])) == pytest.approx(0.21)
