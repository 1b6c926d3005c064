"""The ways to hold the tool along a thread."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.config import PlannerConfig
from agents.planner.ways import along_slide, reached, steps_along_slide, ways_along

CONFIG = PlannerConfig()
VIEW, BASE = 0, 1


def leaning(degrees, n=5):
    """Places 60 mm ahead on a thread that leans by so much away from the viewing ray, towards +x."""
    points = np.tile([0.0, 0.0, 0.06], (n, 1))
    a = np.radians(degrees)
    return points, np.tile([np.sin(a), 0, np.cos(a)], (n, 1))


@pytest.mark.parametrize(("degrees", "clear"), [(90, True), (31, True), (29, False), (150.5, False), (149, True)])
def test_the_viewing_ray_counts_where_it_is_30_degrees_clear_of_the_thread(degrees, clear):
    ways = ways_along(*leaning(degrees), np.array([0.05, 0, 0]), CONFIG)
    assert (ways.clear[VIEW] == clear).all()


def test_the_approach_from_the_base_lies_in_the_plane_of_its_ray():
    points, tangents = leaning(5)
    base = np.array([0.03, 0.08, 0.02])
    ways = ways_along(points, tangents, base, CONFIG)
    assert ways.clear[BASE].all()
    fingers = ways.on_thread[BASE, 0, 0, :3, 2]
    ray = points[0] - base
    assert np.linalg.det(np.array([fingers, ray, tangents[0]])) == pytest.approx(0, abs=1e-12)
    assert fingers @ ray > 0
    assert fingers @ tangents[0] == pytest.approx(0, abs=1e-12)


def test_distances_from_the_thread_are_those_of_the_configuration():
    points, tangents = leaning(70)
    ways = ways_along(points, tangents, np.array([0.05, 0, 0]), CONFIG)
    fingers = ways.on_thread[..., :3, 2]
    for poses, before in ((ways.on_thread, 0.0082), (ways.standoff, 0.0232), (ways.lifted, 0.0132)):
        np.testing.assert_allclose(poses[..., :3, 3] + before * fingers, np.broadcast_to(points, fingers.shape))


def test_both_sides_of_the_jaws_have_the_thread_on_their_axis():
    points, tangents = leaning(70)
    ways = ways_along(points, tangents, np.array([0.05, 0, 0]), CONFIG)
    np.testing.assert_allclose(ways.on_thread[:, 0, :, :3, 0], -np.stack((tangents, tangents)))
    np.testing.assert_allclose(ways.on_thread[:, 1, :, :3, 0], np.stack((tangents, tangents)))


@pytest.mark.parametrize(("turn_deg", "steady"), [(40, True), (50, False)])
def test_a_thread_that_turns_more_than_45_degrees_in_a_step_is_not_steady(turn_deg, steady):
    a = np.radians([0, turn_deg])
    points, tangents = np.tile([0.0, 0, 0.06], (2, 1)), np.column_stack((np.cos(a), np.sin(a), [0, 0]))
    ways = ways_along(points, tangents, np.array([0.05, 0, 0]), CONFIG)
    assert ways.steady[VIEW, 0] == steady


MASKS = st.lists(st.booleans(), min_size=2, max_size=12)


@given(MASKS, st.data())
def test_along_a_slide_something_holds_at_every_sample_to_the_goal(mask, data):
    goal = data.draw(st.integers(0, len(mask) - 1))
    expected = [all(mask[min(i, goal) : max(i, goal) + 1]) for i in range(len(mask))]
    np.testing.assert_array_equal(along_slide(np.array(mask), goal), expected)


@given(MASKS, st.data())
def test_along_a_slide_something_holds_at_every_step_to_the_goal(mask, data):
    goal = data.draw(st.integers(0, len(mask)))
    expected = [all(mask[min(i, goal) : max(i, goal)]) for i in range(len(mask) + 1)]
    np.testing.assert_array_equal(steps_along_slide(np.array(mask), goal), expected)


def test_a_capture_is_reached_where_its_standoff_its_slide_and_the_lift_off_are():
    """Along x, from -20 to 20 mm: what reaches only some depth and some columns decides by arithmetic."""
    x = np.linspace(-0.02, 0.02, 9)
    points = np.column_stack((x, 0 * x, 0 * x + 0.06))
    ways = ways_along(points, np.tile([1.0, 0, 0], (9, 1)), np.array([0.05, 0, 0]), CONFIG)
    origin = ways.on_thread[..., :3, 3]

    def right_of(limit):
        return reached(ways, 6, lambda T: T[:, 0, 3] >= limit)[VIEW]

    slides = origin[VIEW, :, :, 0] >= -0.006
    starts = ways.standoff[VIEW, :, :, 0, 3] >= -0.006
    np.testing.assert_array_equal(right_of(-0.006), along_slide(slides, 6) & starts)
    assert right_of(-0.006).any()
    assert not reached(ways, 6, lambda T: abs(T[:, 2, 3] - 0.0368) > 1e-6)[VIEW].any(), "the approach starts there"
    assert not reached(ways, 6, lambda T: abs(T[:, 2, 3] - 0.0468) > 1e-6)[VIEW].any(), "the lift-off passes there"
    only_on_one_side = reached(ways, 6, lambda T: T[:, 0, 0] > 0)[VIEW]
    np.testing.assert_array_equal(only_on_one_side.all(axis=1), [False, True])
    assert not only_on_one_side[0].any()
