"""The thread as a polyline, the tube of 95 % about it, and how far the middle of it in an image lies from it."""

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
    along_at,
    closeness,
    cross_sections,
    residuals,
    summary,
    thread_polyline,
    whiskers,
)
from schemas.messages import Centrelines
from shared.splines import evaluate


@pytest.fixture(scope="module")
def thread(scene):
    found = thread_polyline(scene.reconstruction, 101)
    assert found is not None
    return found


@given(data=st.data(), degree=st.integers(1, 5))
def test_any_message_is_a_curve_before_the_camera_or_none(scene, data, degree):
    m = data.draw(st.integers(degree + 1, degree + 4))
    inner = st.lists(st.floats(1e-300, 1 - 1e-9), min_size=m - degree - 1, max_size=m - degree - 1, unique=True)
    knots = np.concatenate((np.zeros(degree + 1), np.sort(data.draw(inner)), np.ones(degree + 1)))
    control = data.draw(arrays(np.float64, (m, 3), elements=st.floats(-1e300, 1e300)))
    odd = dataclasses.replace(scene.reconstruction, degree=degree, knots=knots, control_points_camera=control)
    thread = thread_polyline(odd, 20)
    if thread is not None:
        assert np.isfinite(thread.points_camera).all()
        assert (thread.points_camera[:, 2] > 0).all()


def test_points_lie_evenly_on_the_whole_curve_and_only_where_it_is_one_before_the_camera(scene, thread):
    steps = np.linalg.norm(np.diff(thread.points_camera, axis=0), axis=1)
    assert np.ptp(steps) < 0.01 * steps.mean()
    nearest = np.linalg.norm(thread.points_camera[:, None] - scene.curve[None], axis=2).min(axis=1)
    assert nearest.max() < 0.1
    assert np.linalg.norm(thread.points_camera[[0, -1]] - scene.curve[[0, -1]], axis=1).max() < 0.1
    assert thread.length == pytest.approx(scene.length, rel=1e-3)
    # the scene's thread was fitted by its length
    assert np.allclose(along_at(thread, np.linspace(0, 1, 11)), np.linspace(0, 1, 11), atol=0.01)
    assert np.flatnonzero(thread.unseen).tolist() == list(range(56, 67))
    assert thread.along[thread.confidence.argmin()] == pytest.approx(0.62, abs=0.01)
    behind = scene.reconstruction.control_points_camera - [0, 0, 95.0]
    for control in (behind, np.ones_like(behind)):
        assert thread_polyline(dataclasses.replace(scene.reconstruction, control_points_camera=control)) is None


@settings(max_examples=10)
@given(root=arrays(np.float64, (3, 3), elements=st.floats(-2, 2)))
def test_rings_are_the_ellipse_of_95_percent_in_the_plane_across_the_thread(scene, thread, root):
    told, covariance = scene.reconstruction, root @ root.T + 1e-3 * np.eye(3)
    everywhere = np.broadcast_to(covariance, (len(told.posterior_s), 3, 3)).copy()
    sections = cross_sections(dataclasses.replace(told, posterior_covariance=everywhere), thread)
    curve = told.knots, told.control_points_camera, told.degree
    centres = evaluate(*curve, told.posterior_s)
    tangents = evaluate(*curve, told.posterior_s, derivative=1)
    for ring, centre, tangent, deviation in zip(
        sections.rings_camera, centres, tangents, sections.deviation, strict=True
    ):
        across = np.linalg.svd(tangent[None])[2][1:].T
        offset = ring - centre
        assert np.abs(offset @ tangent).max() < 1e-6 * np.linalg.norm(tangent)
        within = across.T @ covariance @ across
        squared = np.einsum("ki,ij,kj->k", offset @ across, np.linalg.inv(within), offset @ across)
        assert np.allclose(squared, -2 * np.log(0.05), rtol=1e-3)
        assert deviation == pytest.approx(np.sqrt(np.linalg.eigvalsh(within)[-1]), rel=1e-6)
    first = sections.rings_camera[:, 0] - centres
    assert (np.sum(first[1:] * first[:-1], axis=1) > 0).all(), "the tube is not twisted"


def beside(thread, points, curve_px):
    """Residuals of points of a thread 4 px wide."""
    count = len(points)
    line = Centrelines(np.asarray(points, float), np.zeros(count, np.int64), np.full(count, 4.0), np.full(count, 0.1))
    return residuals(line, thread, curve_px)


@settings(max_examples=20)
@given(points=arrays(np.float64, (7, 2), elements=st.floats(-50, 150)), bend=st.floats(-40, 40))
def test_a_residual_is_the_distance_to_the_nearest_place_of_the_curve(thread, points, bend):
    x = np.linspace(0, 100, len(thread.along))
    curve_px = np.column_stack((x, bend * np.sin(x / 30)))
    of = beside(thread, points, curve_px)
    dense = np.column_stack([np.interp(np.linspace(0, 1, 40_000), thread.along, axis) for axis in curve_px.T])
    nearest = np.array([np.hypot(*(dense - point).T).min() for point in points])
    assert np.allclose(of.distance_px, nearest, atol=0.01)
    assert np.allclose(np.hypot(*(of.point_px - of.foot_px).T), of.distance_px)
    at_along = np.column_stack([np.interp(of.along, thread.along, axis) for axis in curve_px.T])
    assert np.allclose(at_along, of.foot_px, atol=1e-6)


def test_what_lies_farther_off_than_the_thread_is_wide_is_left_over_and_whiskers_are_as_long_as_said(thread):
    straight = np.column_stack((np.linspace(0, 100, len(thread.along)), np.zeros(len(thread.along))))
    of = beside(thread, [[10, 0.5], [20, -1], [30, 30], [40, 0]], straight)
    assert summary(of) == ResidualSummary(pytest.approx(0.5), pytest.approx(0.95), pytest.approx(0.25))  # type: ignore[arg-type]
    foot, tip = np.moveaxis(whiskers(of), 1, 0)
    assert np.allclose(foot, [[10, 0], [20, 0], [30, 0], [40, 0]])
    expected = [[10, 0.5 * EXAGGERATION], [20, -EXAGGERATION], [30, LONGEST_WHISKER_PX], [40, 0]]
    assert np.allclose(tip, expected)
    assert closeness(of) == pytest.approx([0.75, 0.5, 0, 1])
    nowhere = beside(thread, [[10, 1]], np.full_like(straight, np.nan))
    assert summary(nowhere) == ResidualSummary(None, None, 1.0)
    assert np.isfinite(whiskers(nowhere)).all()
    assert summary(beside(thread, np.zeros((0, 2)), straight)) == ResidualSummary(None, None, None)
