import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.viewer.polyline import thread_polyline
from agents.viewer.residuals import (
    EXAGGERATION,
    LONGEST_WHISKER_PX,
    both_residuals,
    closeness,
    residuals,
    summary,
    whiskers,
)
from schemas.messages import Centrelines
from schemas.messages.thread import no_centrelines


@pytest.fixture(scope="module")
def thread(refined):
    found = thread_polyline(refined.reconstruction)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def found(refined, thread):
    return both_residuals(refined.observations, thread)


def line_of(points, width=4.0):
    n = len(points)
    return Centrelines(np.asarray(points, float), np.zeros(n, np.int64), np.full(n, width), np.full(n, 0.1))


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


def test_the_summary_of_each_image_is_what_its_centreline_was_shifted_by(found):
    left, right = (summary(of) for of in found)
    assert left.median_px == pytest.approx(0.3, abs=0.02)
    assert left.percentile_95_px == pytest.approx(0.3, abs=0.03)
    assert right.median_px == pytest.approx(0.2, abs=0.02)
    assert right.percentile_95_px == pytest.approx(4.0, abs=0.2)
    assert left.left_over == right.left_over == 0


def test_what_lies_farther_off_than_the_thread_is_wide_is_left_over_and_no_residual(thread):
    curve_px = np.column_stack((np.linspace(0, 100, len(thread.along)), np.zeros(len(thread.along))))
    of = summary(residuals(line_of([[10, 1], [20, 1], [30, 1], [40, 30]]), thread, curve_px))
    assert of.median_px == pytest.approx(1.0)
    assert of.percentile_95_px == pytest.approx(1.0)
    assert of.left_over == pytest.approx(0.25)
    nothing_claimed = summary(residuals(line_of([[40, 30]]), thread, curve_px))
    assert (nothing_claimed.median_px, nothing_claimed.left_over) == (None, 1.0)


def test_an_image_without_thread_has_no_residuals(thread):
    of = residuals(no_centrelines(), thread, np.zeros((len(thread.along), 2)))
    assert len(of.along) == len(whiskers(of)) == len(closeness(of)) == 0
    assert summary(of) == summary(of).__class__(None, None, None)


def test_whiskers_are_exaggerated_as_said_and_no_longer_than_said(thread):
    curve_px = np.column_stack((np.linspace(0, 100, len(thread.along)), np.zeros(len(thread.along))))
    of = residuals(line_of([[10, 0.5], [20, -1], [30, 30], [40, 0]]), thread, curve_px)
    foot, tip = np.moveaxis(whiskers(of), 1, 0)
    assert np.allclose(foot, [[10, 0], [20, 0], [30, 0], [40, 0]])
    expected = [[10, 0.5 * EXAGGERATION], [20, -EXAGGERATION], [30, LONGEST_WHISKER_PX], [40, 0]]
    assert np.allclose(tip, expected)


def test_a_curve_at_the_edge_of_the_thread_is_as_far_off_as_colours_tell(thread):
    curve_px = np.column_stack((np.linspace(0, 100, len(thread.along)), np.zeros(len(thread.along))))
    of = residuals(line_of([[10, 0], [20, 1], [30, 2], [40, 9]], width=4.0), thread, curve_px)
    assert closeness(of) == pytest.approx([1, 0.5, 0, 0])


def test_a_curve_that_projects_nowhere_explains_nothing(thread, refined):
    of = residuals(refined.observations.centrelines_left, thread, np.full((len(thread.along), 2), np.nan))
    assert summary(of).left_over == 1.0
    assert np.isfinite(whiskers(of)).all()


def test_points_of_another_camera_do_not_stop_the_comparison(refined, thread):
    huge = dataclasses.replace(refined.observations.camera, fx_px=1e12, fy_px=1e12)
    left, _ = both_residuals(dataclasses.replace(refined.observations, camera=huge), thread)
    assert summary(left).left_over == 1.0
