import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from shared import rigid_transforms as rigid

ANGLES = (0.0, 1e-300, 1e-12, 1e-7, 1e-3, 0.49, 0.51, 1.5, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12)
random_twists = st.lists(st.floats(-10, 10), min_size=6, max_size=6).map(np.array)


def rotation_vectors(angle):
    """Random axes and the coordinate axes, both ways, scaled to one angle."""
    axes = np.random.default_rng(3).normal(size=(20, 3))
    axes = np.concatenate((axes, np.eye(3), -np.eye(3)))
    return angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", (*ANGLES, np.pi))
def test_rotations_agree_with_scipy_as_vectors_quaternions_and_angles_between(angle):
    vectors = rotation_vectors(angle)
    theirs, R = Rotation.from_rotvec(vectors), rigid.exp_so3(vectors)
    np.testing.assert_allclose(R, theirs.as_matrix(), atol=1e-14)
    q = rigid.quaternion_from_rotation(R)
    assert (q[:, 0] >= 0).all()
    np.testing.assert_allclose(np.abs((q * theirs.as_quat(scalar_first=True)).sum(axis=1)), 1, atol=1e-14)
    # of any length and sign, but zero
    np.testing.assert_allclose(rigid.rotation_from_quaternion(-7 * q), R, atol=1e-14)
    other = rigid.exp_so3(np.array((0.3, -2.0, 1.1)))
    np.testing.assert_allclose(rigid.angle_between(other, other @ R), angle, rtol=1e-6, atol=1e-15)
    # the logarithm of a half turn is one of two
    logarithms = rigid.log_so3(R)
    np.testing.assert_allclose(np.linalg.norm(logarithms, axis=1), angle, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(rigid.exp_so3(logarithms), R, atol=1e-14)
    with pytest.raises(ValueError, match="length zero"):
        rigid.rotation_from_quaternion(np.zeros(4))


@pytest.mark.parametrize("angle", ANGLES)
def test_the_exponential_of_a_twist_is_the_matrix_exponential_and_the_logarithm_undoes_it(angle):
    rotation = rotation_vectors(angle)
    twists = np.concatenate((np.random.default_rng(4).normal(size=rotation.shape), rotation), axis=1)
    matrices = np.zeros((len(twists), 4, 4))
    matrices[:, :3, :3], matrices[:, :3, 3] = np.cross(np.eye(3), rotation[:, None]), twists[:, :3]
    np.testing.assert_allclose(rigid.exp_se3(twists), np.stack([expm(each) for each in matrices]), atol=1e-13)
    np.testing.assert_allclose(rigid.log_se3(rigid.exp_se3(twists)), twists, rtol=1e-9, atol=2e-11)


@settings(max_examples=15)
@given(random_twists, random_twists)
def test_transforms_follow_each_other_are_undone_by_their_inverses_and_move_each_its_own_points(a, b):
    both = rigid.exp_se3(np.stack((a, b)))
    (A, B), points = both, np.random.default_rng(5).normal(size=(2, 7, 3))
    moved = points @ both[:, :3, :3].swapaxes(1, 2) + both[:, None, :3, 3]
    np.testing.assert_allclose(rigid.apply(both, points), moved, atol=1e-12)
    np.testing.assert_allclose(rigid.compose(A, B), A @ B, atol=1e-12)
    np.testing.assert_allclose(rigid.compose(A, rigid.inverse(A)), np.eye(4), atol=1e-12)
    np.testing.assert_array_equal(rigid.transform(A[:3, :3], A[:3, 3]), A)


def test_nearest_rotation_undoes_stretch_and_none_nearby_is_closer():
    R, Q = rigid.exp_so3(np.array([[0.4, -1.0, 2.0], [1.0, 0.3, 0.2]]))
    stretch = Q @ np.diag([0.5, 1.1, 3.0]) @ Q.T
    np.testing.assert_allclose(rigid.nearest_rotation(R @ stretch), R, atol=1e-14)
    rng = np.random.default_rng(7)
    matrices = rng.normal(size=(50, 3, 3))
    nearest = rigid.nearest_rotation(matrices)
    np.testing.assert_allclose(np.linalg.det(nearest), 1, atol=1e-12)
    moved = nearest @ rigid.exp_so3(1e-3 * rng.normal(size=(50, 3)))
    assert (np.linalg.norm(moved - matrices, axis=(1, 2)) >= np.linalg.norm(nearest - matrices, axis=(1, 2))).all()
    assert rigid.orthonormality_error(np.diag([1.0, 1.0, 1.1])) == pytest.approx(0.21)
