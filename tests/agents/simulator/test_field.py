"""A thread keeps its length wherever a jaw takes it, stays out of the tissue, and falls when it is let go."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.simulator.field import (
    MM,
    SAMPLES,
    Field,
    carried,
    distance_to_thread,
    field_of,
    field_with,
    settled,
)
from schemas.messages import RectifiedStereo
from shared.rendering.centreline import Thread
from shared.rendering.surface import depth_at_points, flat_surface
from shared.rendering.thread_shapes import CONFIGS
from shared.splines import clamped_uniform_knots, evaluate

CAMERA_MM = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)


def polyline_length(field: Field) -> float:
    s = np.linspace(0, 1, 20001)
    points = evaluate(field.knots, field.control_points, 3, s)
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


@pytest.fixture(scope="module", params=CONFIGS)
def field(request) -> Field:
    return field_of(CAMERA_MM, request.param, "tissue", 95.0, 5)


@pytest.fixture(scope="module")
def flat() -> Field:
    """A straight thread of 60 mm, 0.5 mm above a plane."""
    ends = np.linspace((-30.0, 2.0, 94.5), (30.0, 2.0, 94.5), 6)
    return field_with(Thread(clamped_uniform_knots(6), ends, 0.2), flat_surface(95.0))


def test_samples_are_even_along_a_thread_that_starts_where_the_left_image_shows_it_first(field):
    steps = np.linalg.norm(np.diff(field.points, axis=0), axis=1)
    # a chord is shorter than its arc where the thread bends
    assert np.ptp(steps) < 1e-3 * steps.mean()
    assert field.length_m == pytest.approx(polyline_length(field), rel=1e-6)
    u = field.points[[0, -1], 0] / field.points[[0, -1], 2]
    assert u[0] <= u[1]
    assert field.points[[0, -1]] == pytest.approx(field.control_points[[0, -1]])


def test_a_jaw_that_does_not_move_leaves_the_thread_and_one_that_presses_keeps_it_out_of_the_tissue(field):
    held = carried(field, 300, field.points[300])
    assert np.abs(held.points - field.points).max() < 0.03 * MM
    pressed = carried(field, 400, field.points[400] + (0, 0, 10 * MM))
    floor = MM * depth_at_points(field.surface, pressed.points[:, :2] / MM)
    assert (pressed.points[:, 2] - floor).max() < 0.05 * MM


@settings(max_examples=12)
@given(
    sample=st.integers(0, SAMPLES - 1),
    lift=st.tuples(st.floats(-15, 15), st.floats(-15, 15), st.floats(-35, -1)),
)
def test_a_carried_thread_keeps_its_length_and_is_where_the_jaw_is(field, sample, lift):
    to = field.points[sample] + MM * np.array(lift)
    held = carried(field, sample, to)
    # a jaw that drags the thread along the tissue may press it into a bump, where it gives
    assert polyline_length(held) == pytest.approx(field.length_m, rel=0.03)
    lowest = MM * depth_at_points(field.surface, to[None, :2] / MM)[0] - field.radius_m
    assert np.linalg.norm(held.points[sample] - (*to[:2], min(to[2], lowest))) < 0.2 * MM


def test_a_lift_fades_along_the_thread(flat):
    held = carried(flat, 400, flat.points[400] + (0, 0, -5 * MM))
    risen = flat.points[:, 2] - held.points[:, 2]
    assert risen[400] == pytest.approx(5 * MM, abs=0.01 * MM)
    assert (np.diff(risen[:401]) > -1e-6).all()
    assert (np.diff(risen[400:]) < 1e-6).all()
    assert np.abs(risen[:50]).max() < 0.02 * MM
    # both ends are drawn in by what the way over the bump is longer
    assert held.points[0, 0] - flat.points[0, 0] == pytest.approx(flat.points[-1, 0] - held.points[-1, 0], abs=1e-5)
    assert held.points[0, 0] > flat.points[0, 0]


def test_a_thread_that_is_let_go_lies_no_higher_than_it_was_drawn_and_keeps_its_length(field):
    up = carried(field, 400, field.points[400] + (3 * MM, 0, -20 * MM))
    fallen = settled(up, 400)
    height = MM * depth_at_points(field.surface, fallen.points[:, :2] / MM) - fallen.points[:, 2]
    assert (height - field.height_m).max() < 0.1 * MM
    assert height.min() > -0.05 * MM
    assert polyline_length(fallen) == pytest.approx(field.length_m, rel=0.03)


def test_the_distance_to_a_straight_thread_is_that_to_a_line(flat):
    assert distance_to_thread(flat, MM * np.array([3.3, 5.0, 90.5])) == pytest.approx(5 * MM)
    assert distance_to_thread(flat, MM * np.array([34.0, 2.0, 97.5])) == pytest.approx(5 * MM)
