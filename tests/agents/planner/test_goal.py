"""Goals by s, by pixel and by point."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, curve_of
from agents.planner.goal import goal_on_thread, nearest_on_polyline

CONFIG = PlannerConfig()
SHARE = st.floats(0, 1)


@pytest.fixture(scope="session")
def wavy(bench):
    x = np.linspace(-25, 25, 12)
    return curve_of(bench.thread(np.column_stack((x, 8 * np.sin(x / 6), 70 + 10 * np.cos(x / 9)))))


def pixel_of(bench, point_m):
    """Pinhole projection, written out again."""
    x, y, z = point_m
    return 1000 * x / z + bench.CAMERA.cx_px, 1000 * y / z + bench.CAMERA.cy_px


@given(SHARE)
def test_a_goal_by_s_by_its_pixel_and_by_its_point_is_that_place(bench, wavy, s):
    point = wavy.points(np.array([s]))[0]
    assert goal_on_thread(bench.goal(s=s), wavy, CONFIG) == s
    assert goal_on_thread(bench.goal(pixel=pixel_of(bench, point)), wavy, CONFIG) == pytest.approx(s, abs=1e-4)
    assert goal_on_thread(bench.goal(point_camera=point), wavy, CONFIG) == pytest.approx(s, abs=1e-4)


@given(st.floats(-19.9, 19.9), st.floats(-0.0049, 0.0049))
def test_a_goal_beside_a_straight_thread_is_its_foot(bench, off_px, off_m):
    curve = curve_of(bench.straight())
    assert goal_on_thread(bench.goal(pixel=(579.5, 269.5 + off_px)), curve, CONFIG) == pytest.approx(0.65)
    assert goal_on_thread(bench.goal(point_camera=(0.01, off_m, 0.06)), curve, CONFIG) == pytest.approx(0.75)


def test_a_goal_off_the_thread_or_its_end_is_rejected_with_the_distance(bench):
    curve = curve_of(bench.straight())
    with pytest.raises(NoGraspError, match=r"pixel \(480, 310\) is 40 px off the thread, and at most 20 px"):
        goal_on_thread(bench.goal(pixel=(479.5, 309.5)), curve, CONFIG)
    with pytest.raises(NoGraspError, match=r"7\.0 mm off the thread, and at most 5\.0 mm"):
        goal_on_thread(bench.goal(point_camera=(0, 0.007, 0.06)), curve, CONFIG)
    with pytest.raises(NoGraspError, match=r"10\.0 mm off"):
        goal_on_thread(bench.goal(point_camera=(0.03, 0, 0.06)), curve, CONFIG)
    assert goal_on_thread(bench.goal(point_camera=(0.023, 0, 0.06)), curve, CONFIG) == 1


def test_a_thread_behind_the_camera_is_at_no_pixel(bench):
    curve = curve_of(bench.straight((-20, 0, -60), (20, 0, -60)))
    with pytest.raises(NoGraspError, match="off the thread"):
        goal_on_thread(bench.goal(pixel=(479.5, 269.5)), curve, CONFIG)


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=2, max_size=8), st.floats(-9, 9))
def test_the_nearest_place_of_a_polyline_is_no_farther_than_any_sample_of_it(corners, at):
    vertices, target = np.array(corners), np.array([at, -at / 2])
    place, distance = nearest_on_polyline(vertices, target)
    i = min(int(place), len(vertices) - 2)
    there = vertices[i] + (place - i) * (vertices[i + 1] - vertices[i])
    assert np.linalg.norm(there - target) == pytest.approx(distance, abs=1e-6)
    fine = np.linspace(0, len(vertices) - 1, 500)
    samples = np.column_stack([np.interp(fine, np.arange(len(vertices)), axis) for axis in vertices.T])
    assert distance <= np.linalg.norm(samples - target, axis=1).min() + 1e-9
