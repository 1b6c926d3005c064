"""The ways to hold the tool along a thread."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.config import PlannerConfig
from agents.planner.ways import along_slide, reached, steps_along_slide, ways_along

CONFIG = PlannerConfig()
VIEW = 0


def leaning(degrees, n=5):
    """Places 60 mm ahead on a thread that leans by so much away from the viewing ray, towards +x."""
    points = np.tile([0.0, 0.0, 0.06], (n, 1))
    a = np.radians(degrees)
    return points, np.tile([np.sin(a), 0, np.cos(a)], (n, 1))


@pytest.mark.parametrize(("degrees", "clear"), [(90, True), (31, True), (29, False), (150.5, False), (149, True)])
def test_the_viewing_ray_counts_where_it_is_30_degrees_clear_of_the_thread(degrees, clear):
    ways = ways_along(*leaning(degrees), np.array([0.05, 0, 0]), CONFIG)
    assert (ways.clear[VIEW] == clear).all()


@pytest.mark.parametrize(("turn_deg", "steady"), [(40, True), (50, False)])
def test_a_thread_that_turns_more_than_45_degrees_in_a_step_is_not_steady(turn_deg, steady):
    a = np.radians([0, turn_deg])
    points, tangents = np.tile([0.0, 0, 0.06], (2, 1)), np.column_stack((np.cos(a), np.sin(a), [0, 0]))
    ways = ways_along(points, tangents, np.array([0.05, 0, 0]), CONFIG)
    assert ways.steady[VIEW, 0] == steady


@given(st.lists(st.booleans(), min_size=2, max_size=12), st.data())
def test_along_a_slide_something_holds_at_every_sample_and_every_step_to_the_goal(mask, data):
    mask = np.array(mask)
    goal = data.draw(st.integers(0, len(mask) - 1))
    samples = [mask[min(i, goal) : max(i, goal) + 1].all() for i in range(len(mask))]
    np.testing.assert_array_equal(along_slide(mask, goal), samples)
    steps = [mask[min(i, goal) : max(i, goal)].all() for i in range(len(mask) + 1)]
    np.testing.assert_array_equal(steps_along_slide(mask, goal), steps)


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
