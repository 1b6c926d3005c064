import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.viewer.polyline import (
    EXAGGERATION,
    LONGEST_WHISKER_PX,
    ResidualSummary,
    both_residuals,
    closeness,
    residuals,
    summary,
    thread_polyline,
    whiskers,
)
from schemas.messages import Centrelines
from schemas.messages.thread import no_centrelines


@pytest.fixture(scope="module")
def thread(refined):
    found = thread_polyline(refined.reconstruction)
    assert found is not None
    return found


def line_of(points, width=4.0):
    n = len(points)
    return Centrelines(np.asarray(points, float), np.zeros(n, np.int64), np.full(n, width), np.full(n, 0.1))


def beside_a_straight_line(thread, points):
    """Residuals of these points to a curve that projects to the first 100 px of the u axis."""
    curve_px = np.column_stack((np.linspace(0, 100, len(thread.along)), np.zeros(len(thread.along))))
    return residuals(line_of(points), thread, curve_px)


@settings(max_examples=20)
@given(points=arrays(np.float64, (7, 2), elements=st.floats(-50, 150)), bend=st.floats(-40, 40))
def test_a_residual_is_the_distance_to_the_nearest_place_of_the_curve(thread, points, bend):
    x = np.linspace(0, 100, len(thread.along))
    curve_px = np.column_stack((x, bend * np.sin(x / 30)))
    of = residuals(line_of(points), thread, curve_px)
    dense = np.column_stack([np.interp(np.linspace(0, 1, 40_000), thread.along, axis) for axis in curve_px.T])
    nearest = np.array([np.hypot(*(dense - point).T).min() for point in points])
    assert np.allclose(of.distance_px, nearest, atol=0.01)
    assert np.allclose(np.hypot(*(of.point_px - of.foot_px).T), of.distance_px)
    at_along = np.column_stack([np.interp(of.along, thread.along, axis) for axis in curve_px.T])
    assert np.allclose(at_along, of.foot_px, atol=1e-6)


def test_what_lies_farther_off_than_the_thread_is_wide_is_left_over_and_no_residual(thread):
    of = summary(beside_a_straight_line(thread, [[10, 1], [20, 1], [30, 1], [40, 30]]))
    assert of == ResidualSummary(pytest.approx(1.0), pytest.approx(1.0), pytest.approx(0.25))  # type: ignore[arg-type]
    assert summary(beside_a_straight_line(thread, [[40, 30]])) == ResidualSummary(None, None, 1.0)


def test_whiskers_are_exaggerated_and_coloured_as_said_and_no_longer_than_said(thread):
    of = beside_a_straight_line(thread, [[10, 0.5], [20, -1], [30, 30], [40, 0]])
    foot, tip = np.moveaxis(whiskers(of), 1, 0)
    assert np.allclose(foot, [[10, 0], [20, 0], [30, 0], [40, 0]])
    expected = [[10, 0.5 * EXAGGERATION], [20, -EXAGGERATION], [30, LONGEST_WHISKER_PX], [40, 0]]
    assert np.allclose(tip, expected)
    assert closeness(of) == pytest.approx([0.75, 0.5, 0, 1])


def test_a_curve_that_projects_nowhere_or_into_another_camera_explains_nothing_and_no_points_need_none(thread, refined):
    curve_px = np.full((len(thread.along), 2), np.nan)
    nowhere = residuals(refined.observations.centrelines_left, thread, curve_px)
    huge = dataclasses.replace(refined.observations.camera, fx_px=1e12, fy_px=1e12)
    elsewhere, _ = both_residuals(dataclasses.replace(refined.observations, camera=huge), thread)
    assert summary(nowhere).left_over == summary(elsewhere).left_over == 1.0
    assert np.isfinite(whiskers(nowhere)).all()
    nothing = residuals(no_centrelines(), thread, curve_px)
    assert len(whiskers(nothing)) == len(closeness(nothing)) == 0
    assert summary(nothing) == ResidualSummary(None, None, None)
