"""Poses of the tool by closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.poses import approach_directions, tool_poses, tool_rotations, turn_between

COMPONENT = st.floats(-1, 1, allow_subnormal=False)
VECTOR = st.tuples(COMPONENT, COMPONENT, COMPONENT).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)


def directed(vector):
    return vector / np.linalg.norm(vector)


def test_on_a_thread_along_x_straight_ahead_the_fingers_point_ahead_and_open_about_x():
    tangent, ray = np.array([[1.0, 0, 0]]), np.array([[0, 0, 0.06]])
    approach, angle = approach_directions(ray, tangent)
    R = tool_rotations(approach, tangent)[0]
    assert angle[0] == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(R, np.diag([-1.0, -1, 1]), atol=1e-15)
    np.testing.assert_allclose(tool_rotations(approach, -tangent)[0], np.eye(3), atol=1e-15)


def test_the_tool_is_the_wrist_turned_by_the_dvrk_s_offset():
    """The wrist of the paper: z along the tangent, y the approach; written out column by column."""
    tangent, approach = directed(np.array([1.0, 2, -0.5])), directed(np.array([2.0, -1, 0]))
    wrist = np.column_stack((np.cross(approach, tangent), approach, tangent))
    R = tool_rotations(approach, tangent)
    np.testing.assert_allclose(R, wrist @ np.array([[0, -1, 0], [0, 0, 1], [-1, 0, 0]]), atol=1e-15)
    np.testing.assert_allclose(R[:, 0], -tangent, atol=1e-15)
    np.testing.assert_allclose(R[:, 2], approach, atol=1e-15)


@given(VECTOR, VECTOR)
def test_rotations_are_right_handed_with_the_approach_across_the_thread_in_the_plane_of_the_ray(ray, tangent):
    ray, tangent = directed(ray), directed(tangent)
    approach, angle = approach_directions(ray, tangent)
    R = tool_rotations(approach, tangent)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1)
    expected = np.arctan2(np.linalg.norm(np.cross(ray, tangent)), abs(ray @ tangent))
    assert angle == pytest.approx(expected, abs=1e-6)
    if expected > 0.01:
        assert np.linalg.det(np.array([ray, tangent, approach])) == pytest.approx(0, abs=1e-9)
        assert approach @ ray > 0


def test_a_ray_along_the_thread_still_gives_a_rotation():
    for tangent in np.eye(3):
        approach, angle = approach_directions(5.0 * tangent, tangent)
        assert angle == pytest.approx(0)
        R = tool_rotations(approach, tangent)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)


@given(VECTOR, VECTOR)
def test_the_other_side_of_the_jaws_is_half_a_turn_about_the_fingers(ray, tangent):
    tangent = directed(tangent)
    approach, _ = approach_directions(ray, tangent)
    one, other = tool_rotations(approach, tangent), tool_rotations(approach, -tangent)
    np.testing.assert_allclose(one @ np.diag([-1.0, -1, 1]), other, atol=1e-12)
    assert turn_between(one, other) == pytest.approx(np.pi)


def test_the_origin_lies_before_the_thread_along_the_fingers():
    T = tool_poses(np.array([1.0, 2, 3]), np.diag([-1.0, -1, 1]), 0.25)
    np.testing.assert_array_equal(T[:, 3], [1, 2, 2.75, 1])


@given(st.floats(0.01, 3.1))
def test_the_turn_between_two_attitudes_is_the_angle_of_their_rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    assert turn_between(np.eye(3), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])) == pytest.approx(angle)
