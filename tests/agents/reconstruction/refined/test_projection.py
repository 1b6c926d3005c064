"""The spline's own basis, its views and their derivatives."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from agents.reconstruction.refined.cubic import basis_at, even_parameters
from agents.reconstruction.refined.projection import (
    LEVEL,
    at_constant_speed,
    pixels_evenly,
    projected,
    projected_evenly,
    row_offsets_px,
)
from shared.camera import project
from shared.splines import clamped_uniform_knots, local_basis

STEP = 1e-5
APART_PX = np.array([0.4, -3.0, 2.0, 5.0])


@pytest.mark.parametrize("spans", [1, 2, 9])
def test_basis_functions_are_those_of_the_clamped_spline(spans):
    s = np.concatenate(([0.0, 1.0, 0.5, 1 / spans], np.random.default_rng(0).random(200)))
    first, values, slopes = basis_at(spans, s)
    other_first, other_values, other_slopes = local_basis(clamped_uniform_knots(spans + 3), 3, s)
    control = np.random.default_rng(1).normal(size=spans + 3)

    def sums(first, basis):
        return (basis * control[first[:, None] + np.arange(4)]).sum(axis=1)

    np.testing.assert_allclose(sums(first, values), sums(other_first, other_values), atol=1e-12)
    np.testing.assert_allclose(sums(first, slopes), sums(other_first, other_slopes), atol=1e-9)


def test_a_view_is_the_projection_in_each_eye_moved_by_half_of_how_far_rows_are_apart_there(spline, camera):
    s = np.linspace(0, 1, 37)
    for eye, px in enumerate(project(camera, BSpline(spline.knots, spline.control_points, 3)(s))):
        level = projected(spline, s, np.full(37, eye), camera, LEVEL)
        np.testing.assert_allclose(level.point_px, px, atol=1e-9)
        apart = projected(spline, s, np.full(37, eye), camera, APART_PX)
        apart_px = row_offsets_px(px, APART_PX, camera)
        assert np.ptp(apart_px) > 0.5
        np.testing.assert_allclose(apart.point_px - px, np.outer((eye - 0.5) * apart_px, (0, 1)), atol=1e-9)


@pytest.mark.parametrize("offset_px", [LEVEL, 10 * APART_PX], ids=["level", "apart"])
@pytest.mark.parametrize("eye", [0, 1])
def test_derivatives_are_finite_differences(spline, camera, eye, offset_px):
    s, eyes = np.linspace(0.02, 0.98, 23), np.full(23, eye)
    view = projected(spline, s, eyes, camera, offset_px)
    ahead, behind = (projected(spline, s + step, eyes, camera, offset_px).point_px for step in (STEP, -STEP))
    np.testing.assert_allclose(view.velocity_px, (ahead - behind) / (2 * STEP), rtol=1e-5, atol=1e-3)
    for axis in range(3):
        push = 1e-4 * np.eye(3)[axis]
        further, back = (projected(spline.moved(sign * push), s, eyes, camera, offset_px).point_px for sign in (1, -1))
        for direction in np.array([(1.0, 0.0), (0.0, 1.0), (0.6, -0.8)]):
            derivative = view.by_point(np.tile(direction[:, None], 23))[:, axis]
            np.testing.assert_allclose(derivative, (further - back) @ direction / 2e-4, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("per_span", [1, 4])
def test_even_places_are_seen_as_any_others(spline, camera, per_span):
    s = even_parameters(spline.spans, per_span)
    np.testing.assert_allclose(spline.evenly(per_span), BSpline(spline.knots, spline.control_points, 3)(s), atol=1e-12)
    even = projected_evenly(spline, per_span, camera, APART_PX)
    view = projected(spline, np.tile(s, 2), np.repeat((0, 1), len(s)), camera, APART_PX)
    np.testing.assert_allclose(even.point_px, view.point_px, atol=1e-9)
    np.testing.assert_allclose(even.velocity_px, view.velocity_px, atol=1e-7)
    pixels = [pixels_evenly(spline, per_span, eye, camera, APART_PX) for eye in (0, 1)]
    np.testing.assert_allclose(np.concatenate(pixels), view.point_px, atol=1e-9)


def test_at_constant_speed_the_curve_stays_and_its_speed_becomes_even(spline):
    warped = BSpline(spline.knots, spline.control_points, 3)(np.linspace(0, 1, 400) ** 1.3)
    basis = BSpline.design_matrix(np.linspace(0, 1, 400), spline.knots, 3).toarray()
    uneven = type(spline)(spline.knots, np.linalg.lstsq(basis, warped, rcond=None)[0])
    marks = np.linspace(0.05, 0.95, 19)
    even, moved = at_constant_speed(uneven, marks)
    np.testing.assert_allclose(even.at(moved), uneven.at(marks), atol=2e-3 * spline.size)
    speed = np.linalg.norm(
        BSpline(even.knots, even.control_points, 3).derivative()(np.linspace(0.05, 0.95, 200)), axis=1
    )
    assert speed.max() / speed.min() < 1.05
    before = np.linalg.norm(BSpline(uneven.knots, uneven.control_points, 3).derivative()(marks), axis=1)
    assert before.max() / before.min() > 1.5
