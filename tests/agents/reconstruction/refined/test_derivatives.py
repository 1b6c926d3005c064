"""Derivatives against finite differences, and equations by blocks against dense ones."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.refined.following import process_noise, stretching
from agents.reconstruction.refined.normal_equations import (
    data_blocks,
    gradient,
    linearised,
    row_offset_columns,
)
from agents.reconstruction.refined.projection import LEVEL, Curve, projected
from shared.splines import clamped_uniform_knots
from tests.agents.reconstruction.threads import CAMERA, dense, sight_of, spline_of, winding

SPLINE = spline_of(winding)
OFFSET_PX = np.array([0.3, -2.0, 1.0, 4.0])
STEP, M = 1e-5, 12


def off_the_curve(sight):
    """Sightings some pixels beside the curve, along its normal, where the derivative of the distance is exact."""
    view = projected(SPLINE, sight.s, sight.eye, CAMERA, OFFSET_PX)
    tangent = view.velocity_px / np.linalg.norm(view.velocity_px, axis=1)[:, None]
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0]))
    push = np.random.default_rng(5).normal(0, 3, (len(sight.s), 1)) * ~sight.is_end[:, None]
    return dataclasses.replace(sight, point_px=view.point_px + push * normal)


@pytest.fixture(scope="module")
def problem():
    sight = off_the_curve(sight_of(SPLINE, 40))
    return sight, linearised(SPLINE, sight, CAMERA, OFFSET_PX)


def design_of(rows):
    """The dense matrix that takes the control points' motion to the change of the residuals."""
    J = np.zeros((len(rows.residual), SPLINE.control_points.size))
    for i, (first, basis, gradient_) in enumerate(zip(rows.first, rows.basis, rows.gradient, strict=True)):
        for j in range(4):
            J[i, 3 * (first + j) : 3 * (first + j) + 3] += basis[j] * gradient_
    return J


def test_derivatives_of_residuals_are_finite_differences(problem):
    sight, rows = problem
    assert rows.sightings == len(sight.s) == len(rows.residual) - sight.is_end.sum()
    J, step = design_of(rows), 1e-5
    for k in range(0, SPLINE.control_points.size, 7):
        push = step * np.eye(SPLINE.control_points.size)[k].reshape(-1, 3)
        ahead, back = (linearised(SPLINE.moved(sign * push), sight, CAMERA, OFFSET_PX).residual for sign in (1, -1))
        np.testing.assert_allclose((ahead - back) / (2 * step), J[:, k], rtol=1e-5, atol=1e-4)
    for k, push in enumerate(1e-3 * np.eye(4)):
        ahead, back = (linearised(SPLINE, sight, CAMERA, OFFSET_PX + sign * push).residual for sign in (1, -1))
        # the normal turns a little, and the points lie off the curve
        np.testing.assert_allclose((ahead - back) / 2e-3, rows.by_row_offset[:, k], rtol=1e-4, atol=2e-2)


def test_blocks_are_the_dense_normal_equations(problem):
    _, rows = problem
    weight = np.random.default_rng(2).uniform(0.1, 1, len(rows.residual))
    J, data = design_of(rows), data_blocks(rows, weight, SPLINE.spans)
    np.testing.assert_allclose(dense(data.H), J.T @ (weight[:, None] * J), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(gradient(data.g), J.T @ (weight * rows.residual), rtol=1e-9, atol=1e-6)
    mixed = gradient(row_offset_columns(rows, weight, SPLINE.spans))
    np.testing.assert_allclose(mixed, J.T @ (weight[:, None] * rows.by_row_offset), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("offset_px", [LEVEL, 10 * OFFSET_PX], ids=["level", "apart"])
@pytest.mark.parametrize("eye", [0, 1])
def test_derivatives_of_views_are_finite_differences(eye, offset_px):
    s, eyes = np.linspace(0.02, 0.98, 23), np.full(23, eye)
    view = projected(SPLINE, s, eyes, CAMERA, offset_px)
    ahead, behind = (projected(SPLINE, s + step, eyes, CAMERA, offset_px).point_px for step in (STEP, -STEP))
    np.testing.assert_allclose(view.velocity_px, (ahead - behind) / (2 * STEP), rtol=1e-5, atol=1e-3)
    for axis in range(3):
        push = 1e-4 * np.eye(3)[axis]
        further, back = (projected(SPLINE.moved(sign * push), s, eyes, CAMERA, offset_px).point_px for sign in (1, -1))
        for direction in np.array([(1.0, 0.0), (0.0, 1.0), (0.6, -0.8)]):
            derivative = view.by_point(np.tile(direction[:, None], 23))[:, axis]
            np.testing.assert_allclose(derivative, (further - back) @ direction / 2e-4, rtol=1e-6, atol=1e-5)


def line():
    return Curve(clamped_uniform_knots(M), np.column_stack((np.linspace(0, 20.0, M), np.zeros(M), np.full(M, 100.0))))


def test_process_noise_grows_with_time_and_falls_off_along_the_thread():
    noise = process_noise(line(), CAMERA, 1 / 30)
    assert (np.diff(noise) < 0).all()
    assert process_noise(line(), CAMERA, 3 / 30) == pytest.approx(3 * noise)
    assert np.sqrt(noise[0]) == pytest.approx(0.0124 * 960 * 100 / 1000, rel=0.01)


def test_stretching_costs_what_its_gradient_says_and_sliding_nothing():
    curve = line().moved(np.random.default_rng(3).normal(0, 0.2, (M, 3)))

    def cost(control_points):
        s = (np.arange(M - 3) + 0.5) / (M - 3)
        ahead, behind = (Curve(curve.knots, control_points).at(s + step) for step in (1e-6, -1e-6))
        speed = np.linalg.norm(ahead - behind, axis=1) / 2e-6
        return 0.5 * (((speed / 22.0 - 1) / 0.03) ** 2).sum()

    slope = gradient(stretching(curve, 22.0).g).reshape(M, 3)
    for i, axis in ((0, 0), (3, 1), (M - 1, 2)):
        by = np.zeros((M, 3))
        by[i, axis] = 1e-4
        numeric = (cost(curve.control_points + by) - cost(curve.control_points - by)) / 2e-4
        assert slope[i, axis] == pytest.approx(numeric, rel=1e-3, abs=1e-3)
    assert slope.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
