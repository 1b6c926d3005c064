"""Poses of the tool by closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.poses import approach_directions, tool_rotations, turn_between

COMPONENT = st.floats(-1, 1, allow_subnormal=False)
VECTOR = st.tuples(COMPONENT, COMPONENT, COMPONENT).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)


def directed(vector):
    return vector / np.linalg.norm(vector)


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


@given(st.floats(0.01, 3.1))
def test_the_turn_between_two_attitudes_is_the_angle_of_their_rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    assert turn_between(np.eye(3), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])) == pytest.approx(angle)
