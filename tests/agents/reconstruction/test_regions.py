"""Around each observation a region of trust, and how sure each part of a thread is from their depth bounds."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.reconstruction.paper import assumed_unit, confidence_along
from agents.reconstruction.regions import fit_depth, half_pixel_depth, is_borrowed
from shared.camera import backproject, project
from tests.agents.reconstruction.threads import CAMERA


def points_at(u_px, depth):
    u_px, depth = np.asarray(u_px, float), np.asarray(depth, float)
    return backproject(CAMERA, np.column_stack((u_px, np.full(len(u_px), 200.0))), depth)


def neighbourhood(j, count):
    """A tenth of the observations to each side, at least three; at an end one and a half times that on its side."""
    reach = max(3, round(count / 10))
    low, high = j - reach, j + reach
    if low < 0:
        high = max(high, 3 * reach // 2)
    if j + reach > count - 1:
        low = min(low, count - 1 - 3 * reach // 2)
    return slice(max(low, 0), min(high, count - 1) + 1)


def fits_by_polyfit(points):
    """Residual and wanted bound by a line through each neighbourhood's depths, one fit at a time."""
    left_px, _ = project(CAMERA, points)
    t = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(left_px, axis=0), axis=1))))
    residual, bound = [], []
    for j in range(len(t)):
        near = neighbourhood(j, len(t))
        line = np.polyfit(t[near], points[near, 2], 1)
        residual.append(points[j, 2] - np.polyval(line, t[j]))
        bound.append(max(1.5 * abs(residual[-1]), np.std(points[near, 2] - np.polyval(line, t[near]))))
    return np.array(residual), np.array(bound)


@pytest.mark.parametrize("count", [4, 5, 11, 47])
def test_bounds_are_those_of_a_line_fit_in_each_neighbourhood_in_any_unit(count):
    rng = np.random.default_rng(0)
    u_px = 100 + np.cumsum(rng.uniform(2, 12, count))
    points = points_at(u_px, 90 + 0.05 * u_px + rng.normal(size=count))
    residual, bound = fits_by_polyfit(points)
    fit = fit_depth(points, CAMERA)
    assert np.allclose(fit.bound, np.minimum(bound, 0.5 * points[:, 2]), rtol=1e-8)
    assert np.allclose(fit.depth, points[:, 2] - residual, rtol=1e-10)
    for factor in (1e-6, 1e6):
        other = dataclasses.replace(CAMERA, baseline=CAMERA.baseline * factor)
        assert np.allclose(fit_depth(factor * points, other).bound, factor * fit.bound, rtol=1e-6)


def test_depths_on_a_line_have_half_a_pixel_of_disparity_for_a_bound_and_zero_is_replaced_by_the_next():
    z = np.array([60.0, 100.0, 150.0])
    disparity_px = CAMERA.fx_px * CAMERA.baseline / z
    nearer, farther = (CAMERA.fx_px * CAMERA.baseline / (disparity_px + change) for change in (0.5, -0.5))
    assert np.allclose(half_pixel_depth(CAMERA, z), 0.5 * (farther - nearer), rtol=2e-3)
    u_px = np.linspace(100, 500, 60)
    points = points_at(u_px, 90 + 0.1 * (u_px - 100))
    assert np.allclose(fit_depth(points, CAMERA).bound, half_pixel_depth(CAMERA, points[:, 2]), rtol=1e-12)
    points = points_at(u_px, np.append(np.full(50, 90.0), 90.0 + np.resize((0.3, -0.3), 10)))
    _, expected = fits_by_polyfit(points)
    none = expected < 1e-9
    assert 0 < none.sum() < 60
    assert np.allclose(fit_depth(points, CAMERA).bound, np.where(none, expected[~none].min(), expected), rtol=1e-8)


@given(
    depth=st.lists(st.floats(1, 1000), min_size=1, max_size=40).map(np.array),
    seed=st.integers(0, 99),
    repeats=st.integers(1, 4),
)
def test_bounds_hold_the_fitted_depth_and_never_reach_the_camera(depth, seed, repeats):
    u_px = np.repeat(np.random.default_rng(seed).uniform(0, 960, len(depth)), repeats)
    points = points_at(u_px, np.repeat(depth, repeats))
    fit = fit_depth(points, CAMERA)
    assert (fit.bound > 0).all()
    assert (points[:, 2] - fit.bound > 0).all()
    assert (np.abs(fit.depth - points[:, 2]) <= fit.bound * (1 + 1e-9)).all()


def test_the_ends_of_connected_stretches_have_a_borrowed_depth():
    for count, gaps, borrowed in ((5, [], [0, 4]), (6, [2], [0, 2, 3, 5]), (6, [0, 3], [1, 3, 4, 5]), (1, [], [])):
        assert np.flatnonzero(is_borrowed(count, np.array(gaps, np.int64))).tolist() == borrowed


def confidence_of(bound_depth, unit_m=1e-3):
    return confidence_along(np.array([0.5]), np.array([0.0, 0.5, 1.0]), np.full(3, bound_depth), 1.0, unit_m)[0]


def test_confidence_is_flat_up_to_three_millimetres_of_extent_and_then_a_gaussian_of_five():
    for bound_mm, expected in ((0.1, 1.0), (1.5, 1.0), (4.0, np.exp(-0.5)), (6.5, np.exp(-2.0)), (1e6, 0.0)):
        assert confidence_of(bound_mm) == pytest.approx(expected, rel=1e-12)
        assert confidence_of(bound_mm * 1e-3, 1.0) == pytest.approx(expected, rel=1e-9)
    # in an arbitrary unit the share of the working distance counts
    for factor in (1e-6, 1.0, 1e6):
        unit_m = assumed_unit(factor * np.array([11.0, 12.0, 17.0]))
        assert confidence_of(0.04 * 12.0 * factor, unit_m) == pytest.approx(np.exp(-0.5), rel=1e-9)


def test_bounds_are_interpolated_between_regions_held_beyond_them_and_widened_far_from_any():
    at = np.array([0.0, 0.2, 0.5, 0.8, 1.0])
    confidence = confidence_along(at, np.array([0.2, 0.8]), np.array([2.0, 6.0]), 0.0, 1e-3)
    assert np.allclose(confidence, [confidence_of(b) for b in (2.0, 2.0, 4.0, 6.0, 6.0)], rtol=1e-12)
    known = np.array([0.0, 0.1, 0.7, 0.8, 0.9, 1.0])
    sparse = confidence_along(np.linspace(0, 1, 101), known, np.full(6, 0.5), 100.0, 1e-3)
    assert sparse[[0, 10, 70, 100]] == pytest.approx(1.0)
    assert sparse[40] == pytest.approx(confidence_of(0.5 + 0.3 * 30.0), rel=1e-9)
    assert sparse.argmin() == 40
