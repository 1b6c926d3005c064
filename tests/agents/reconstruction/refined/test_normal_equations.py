"""Gauss-Newton's equations by blocks against dense matrices and finite differences."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.refined.normal_equations import (
    damping_blocks,
    data_blocks,
    factored,
    gradient,
    linearised,
    roughness_blocks,
    row_offset_columns,
    solved,
)
from agents.reconstruction.refined.projection import Curve, projected
from shared.splines import basis_matrix

OFFSET_PX = np.array([0.3, -2.0, 1.0, 4.0])


def off_the_curve(sight, spline, camera):
    """Sightings some pixels beside the curve, along its normal, where the derivative of the distance is exact."""
    view = projected(spline, sight.s, sight.eye, camera, OFFSET_PX)
    tangent = view.velocity_px / np.linalg.norm(view.velocity_px, axis=1)[:, None]
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0]))
    push = np.random.default_rng(5).normal(0, 3, (len(sight.s), 1)) * ~sight.is_end[:, None]
    return dataclasses.replace(sight, point_px=view.point_px + push * normal)


@pytest.fixture
def problem(spline, sight_of, camera):
    sight = off_the_curve(sight_of(spline, 40), spline, camera)
    return sight, linearised(spline, sight, camera, OFFSET_PX)


def design_of(rows, spline):
    """The dense matrix that takes the control points' motion to the change of the residuals."""
    J = np.zeros((len(rows.residual), spline.control_points.size))
    for i, (first, basis, gradient_) in enumerate(zip(rows.first, rows.basis, rows.gradient, strict=True)):
        for j in range(4):
            J[i, 3 * (first + j) : 3 * (first + j) + 3] += basis[j] * gradient_
    return J


def test_derivatives_of_residuals_are_finite_differences(problem, spline, camera):
    sight, rows = problem
    assert rows.sightings == len(sight.s) == len(rows.residual) - sight.is_end.sum()
    J, step = design_of(rows, spline), 1e-5
    for k in range(0, spline.control_points.size, 7):
        push = step * np.eye(spline.control_points.size)[k].reshape(-1, 3)
        ahead, back = (linearised(spline.moved(sign * push), sight, camera, OFFSET_PX).residual for sign in (1, -1))
        np.testing.assert_allclose((ahead - back) / (2 * step), J[:, k], rtol=1e-5, atol=1e-4)
    for k, push in enumerate(1e-3 * np.eye(4)):
        ahead, back = (linearised(spline, sight, camera, OFFSET_PX + sign * push).residual for sign in (1, -1))
        # the normal turns a little, and the points lie off the curve
        np.testing.assert_allclose((ahead - back) / 2e-3, rows.by_row_offset[:, k], rtol=1e-4, atol=2e-2)


def test_blocks_are_the_dense_normal_equations(problem, spline, dense):
    _, rows = problem
    weight = np.random.default_rng(2).uniform(0.1, 1, len(rows.residual))
    J, data = design_of(rows, spline), data_blocks(rows, weight, spline.spans)
    np.testing.assert_allclose(dense(data.H), J.T @ (weight[:, None] * J), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(gradient(data.g), J.T @ (weight * rows.residual), rtol=1e-9, atol=1e-6)
    mixed = gradient(row_offset_columns(rows, weight, spline.spans))
    np.testing.assert_allclose(mixed, J.T @ (weight[:, None] * rows.by_row_offset), rtol=1e-9, atol=1e-6)


def test_the_banded_solution_is_the_dense_one_where_there_is_one(problem, spline, dense):
    _, rows = problem
    total = data_blocks(rows, np.ones(len(rows.residual)), spline.spans)
    total = total + damping_blocks(spline) + roughness_blocks(spline, np.full(spline.spans, 50.0))
    g = gradient(total.g)
    np.testing.assert_allclose(solved(factored(total), g), np.linalg.solve(dense(total.H), g), rtol=1e-6)
    with pytest.raises(np.linalg.LinAlgError):
        factored(roughness_blocks(spline, np.ones(spline.spans)) * -1.0)


def by_spans(spline, derivative):
    """Squares of a derivative at both ends of every span, for spans of length 1 and a curve of size 1."""
    ends = (np.arange(spline.spans)[:, None] + [1e-9, 1 - 1e-9]) / spline.spans
    basis = basis_matrix(spline.knots, 3, ends.ravel(), derivative) / spline.spans**derivative / spline.size
    return ((basis @ spline.control_points) ** 2).sum(axis=1).reshape(-1, 2).mean(axis=1)


def test_roughness_is_minimum_variation_span_by_span_and_little_of_bending(spline, dense):
    rng = np.random.default_rng(0)
    weight = rng.uniform(0.1, 10, spline.spans) * (rng.random(spline.spans) < 0.5)
    wild = Curve(spline.knots, rng.normal(size=spline.control_points.shape))
    P, rough = wild.control_points.ravel(), roughness_blocks(wild, weight)
    least = (weight * by_spans(wild, 3)).sum()
    most = least + 0.05 * (weight * by_spans(wild, 2)).sum()
    assert least * (1 - 1e-6) <= P @ dense(rough.H) @ P <= most * (1 + 1e-6)
    np.testing.assert_allclose(gradient(rough.g), dense(rough.H) @ P, rtol=1e-9, atol=1e-9)


def test_only_motion_along_itself_is_damped(spline, dense):
    H = dense(damping_blocks(spline).H)
    s = np.linspace(0, 1, 400)
    basis, slope = (basis_matrix(spline.knots, 3, s, k) for k in (0, 1))
    along = slope @ spline.control_points
    across = np.cross(along, [0.0, 0.0, 1.0])
    pushes = [
        np.linalg.lstsq(basis, way / np.linalg.norm(way, axis=1)[:, None], rcond=None)[0].ravel()
        for way in (along, across)
    ]
    assert pushes[0] @ H @ pushes[0] > 1e3 * (pushes[1] @ H @ pushes[1])
    assert not damping_blocks(spline).g.any()
