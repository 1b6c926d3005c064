"""Around each observation a region of trust: its depth bound by a line fit nearby, its image bound by its width."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.reconstruction.regions import fit_depth, half_pixel_depth, image_bounds, is_borrowed
from shared.camera import backproject, project


def points_at(camera, u_px, depth):
    u_px, depth = np.asarray(u_px, float), np.asarray(depth, float)
    return backproject(camera, np.column_stack((u_px, np.full(len(u_px), 200.0))), depth)


def noisy_points(camera, count, seed=0):
    rng = np.random.default_rng(seed)
    u_px = 100 + np.cumsum(rng.uniform(2, 12, count))
    return points_at(camera, u_px, 90 + 0.05 * u_px + rng.normal(size=count))


def neighbourhood(j, count):
    """A tenth of the observations to each side, at least three; at an end one and a half times that on its side."""
    reach = max(3, round(count / 10))
    low, high = j - reach, j + reach
    if low < 0:
        high = max(high, 3 * reach // 2)
    if j + reach > count - 1:
        low = min(low, count - 1 - 3 * reach // 2)
    return slice(max(low, 0), min(high, count - 1) + 1)


def fits_by_polyfit(camera, points):
    """Residual and wanted bound by a line through each neighbourhood's depths, one fit at a time."""
    left_px, _ = project(camera, points)
    t = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(left_px, axis=0), axis=1))))
    residual, bound = [], []
    for j in range(len(t)):
        near = neighbourhood(j, len(t))
        line = np.polyfit(t[near], points[near, 2], 1)
        residual.append(points[j, 2] - np.polyval(line, t[j]))
        bound.append(max(1.5 * abs(residual[-1]), np.std(points[near, 2] - np.polyval(line, t[near]))))
    return np.array(residual), np.array(bound)


@pytest.mark.parametrize("count", [4, 5, 10, 11, 47, 100])
def test_bounds_are_those_of_a_line_fit_in_each_neighbourhood_in_any_unit(camera, count):
    points = noisy_points(camera, count)
    residual, bound = fits_by_polyfit(camera, points)
    fit = fit_depth(points, camera)
    assert np.allclose(fit.bound, np.minimum(bound, 0.5 * points[:, 2]), rtol=1e-8)
    assert np.allclose(fit.depth, points[:, 2] - residual, rtol=1e-10)
    for factor in (1e-6, 1e6):
        other = dataclasses.replace(camera, baseline=camera.baseline * factor)
        assert np.allclose(fit_depth(factor * points, other).bound, factor * fit.bound, rtol=1e-6)


def test_depths_on_a_line_have_half_a_pixel_of_disparity_for_a_bound(camera):
    z = np.array([60.0, 100.0, 150.0])
    disparity_px = camera.fx_px * camera.baseline / z
    nearer, farther = (camera.fx_px * camera.baseline / (disparity_px + change) for change in (0.5, -0.5))
    assert np.allclose(half_pixel_depth(camera, z), 0.5 * (farther - nearer), rtol=2e-3)
    for slope in (0.0, 0.1):
        u_px = np.linspace(100, 500, 25)
        points = points_at(camera, u_px, 90 + slope * (u_px - 100))
        assert np.allclose(fit_depth(points, camera).bound, half_pixel_depth(camera, points[:, 2]), rtol=1e-12)


def test_a_bound_of_zero_is_replaced_by_the_smallest_other_one(camera):
    depth = np.full(60, 90.0)
    depth[50:] += np.resize((0.3, -0.3), 10)
    points = points_at(camera, np.linspace(100, 500, 60), depth)
    _, expected = fits_by_polyfit(camera, points)
    none = expected < 1e-9
    assert 0 < none.sum() < 60
    assert np.allclose(fit_depth(points, camera).bound, np.where(none, expected[~none].min(), expected), rtol=1e-8)


@given(
    depth=st.lists(st.floats(1, 1000), min_size=1, max_size=40).map(np.array),
    seed=st.integers(0, 99),
    repeats=st.integers(1, 4),
)
def test_bounds_hold_the_fitted_depth_and_never_reach_the_camera(camera, depth, seed, repeats):
    u_px = np.repeat(np.random.default_rng(seed).uniform(0, 960, len(depth)), repeats)
    points = points_at(camera, u_px, np.repeat(depth, repeats))
    fit = fit_depth(points, camera)
    assert (fit.bound > 0).all()
    assert (points[:, 2] - fit.bound > 0).all()
    assert (fit.depth > 0).all()
    assert (np.abs(fit.depth - points[:, 2]) <= fit.bound * (1 + 1e-9)).all()


def test_image_bounds_are_the_segmented_size_within_a_pixel_of_640_and_the_image():
    half_size_px = np.array([[0.5, 3.0], [2.0, 1e9]])
    assert np.array_equal(image_bounds(half_size_px, 640), [[1, 3], [2, 640]])
    assert np.array_equal(image_bounds(half_size_px, 1280), [[2, 3], [2, 1280]])


@pytest.mark.parametrize(
    ("count", "gaps", "borrowed"), [(5, [], [0, 4]), (6, [2], [0, 2, 3, 5]), (6, [0, 3], [1, 3, 4, 5]), (1, [], [])]
)
def test_the_ends_of_connected_stretches_have_a_borrowed_depth(count, gaps, borrowed):
    assert np.flatnonzero(is_borrowed(count, np.array(gaps, np.int64))).tolist() == borrowed
