"""The fit against the thread that the points were made from, and how well it says that it is known."""

import dataclasses

import cv2
import numpy as np
import pytest

from agents.reconstruction.refined.posterior import point_covariance
from agents.reconstruction.refined.projection import Curve, at_constant_speed, fitted, projected
from agents.reconstruction.refined.refinement import Start, refined
from agents.reconstruction.refined.shared_errors import shared_errors
from agents.reconstruction.refined.sightings import Sightings, folds
from shared.calibration.uncertainty import ERRORS
from shared.curve_distance import curve_distance, normal_errors
from shared.splines import clamped_uniform_knots
from tests.agents.reconstruction.threads import CAMERA, sight_of, spline_of, waving, winding

DENSE, WITHIN = np.linspace(0, 1, 2000), np.linspace(0.02, 0.98, 200)
SPLINE, WAVING = spline_of(winding), spline_of(waving, 40)
TURN, STATED_PX = np.radians(0.15), 0.2


def off(curve, truth=SPLINE):
    """How far a curve is from the thread, as a share of its size."""
    found = curve_distance(curve.at(DENSE), truth.at(DENSE))
    return found.mean / truth.size, found.maximum / truth.size


@pytest.mark.parametrize("seed", range(2))
def test_from_a_curve_some_pixels_aside_exact_points_give_the_thread_and_noisy_ones_with_their_deviations(seed):
    rng, k = np.random.default_rng(seed), np.arange(len(SPLINE.control_points))[:, None]
    waves = np.sum(
        [rng.normal(0, 0.15, 3) * np.sin(0.4 * (n + 1) * k + rng.uniform(0, 6, 3)) for n in range(3)], axis=0
    )
    disturbed = SPLINE.moved(waves * [1, 1, 4])
    fit = refined(Start(disturbed, sight_of(SPLINE)), CAMERA)
    mean, most = off(fit.curve)
    assert off(disturbed)[1] > 0.02
    assert (mean < 1e-3, most < 4e-3, np.abs(fit.row_offset_px).max() < 0.05) == (True, True, True)
    fit = refined(Start(disturbed, sight_of(SPLINE, noise_px=0.1, seed=seed)), CAMERA)
    plane = np.linalg.svd(np.gradient(SPLINE.at(DENSE), axis=0)[:, None, :])[2][:, 1:]
    across = np.einsum("qij,qj->qi", plane, fit.curve.at(DENSE) - SPLINE.at(DENSE))
    normal = plane @ point_covariance(fit, CAMERA, DENSE) @ plane.transpose(0, 2, 1)
    squared = np.einsum("qi,qij,qj->q", across, np.linalg.inv(normal), across)
    assert squared.max() < 25
    assert np.median(squared) > 0.01
    assert 0.6 < fit.scale < 1.4


def test_wrong_points_lose_their_say():
    sight = sight_of(SPLINE, noise_px=0.1)
    wrong = np.zeros(len(sight.s), bool)
    wrong[20:28] = wrong[200:206] = True
    spoilt = dataclasses.replace(sight, point_px=sight.point_px + 12.0 * wrong[:, None] * [0.8, 0.6])
    fit = refined(Start(SPLINE, spoilt), CAMERA)
    robust = fit.robust[: fit.rows.sightings]
    assert robust[wrong].max() < 0.1
    assert np.median(robust[~wrong]) > 0.8
    assert off(fit.curve)[0] < 3e-3


def test_a_row_offset_is_found_where_the_images_tell_it_and_no_larger_than_a_calibration_allows():
    fit = refined(Start(WAVING, sight_of(WAVING, 300, 0.1, row_offset_px=-1.2)), CAMERA)
    assert fit.row_offset_px == pytest.approx(np.array([-1.2, 0, 0, 0]), abs=0.25)
    assert off(fit.curve, WAVING)[0] < 5e-3
    level = refined(Start(WAVING, sight_of(WAVING, 300, 0.2, 0.2)), CAMERA)
    assert np.abs(level.row_offset_px).max() < 0.15
    # on a straight thread the images do not tell it from depth, which is then as uncertain as the rows are
    straight = spline_of(lambda t: np.column_stack((-20 + 40 * t, 12 - 24 * t, 95 + 0 * t)), 20)
    fit = refined(Start(straight, sight_of(straight, 300, 0.1, row_offset_px=0.6)), CAMERA)
    assert abs(fit.row_offset_px[0]) < 0.3
    middle = np.array([0.5])
    deeper = abs(fit.curve.at(middle)[0, 2] - 95)
    assert 0.5 < deeper < 4 * np.sqrt(point_covariance(fit, CAMERA, middle)[0, 2, 2])
    # held far straighter than it is, a thread oblique to the rows would have them off by many pixels
    oblique = spline_of(lambda t: np.column_stack((-20 + 34 * t + np.sin(5 * t), 16 - 30 * t, 105 + 5 * np.cos(4 * t))))
    sight = sight_of(oblique, 400, 0.1, row_offset_px=0.6)
    sight = dataclasses.replace(sight, is_end=np.zeros(len(sight.s), bool))
    fit = refined(Start(oblique, sight, smoothing=1e8, weight=np.ones(oblique.spans)), CAMERA, steps=2)
    assert np.abs(fit.row_offset_px).max() < 1.0


def turned(px, axis):
    """Where a camera that is turned by a small angle sees what it would see at these pixels."""
    K = np.array([[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1]])
    R, _ = cv2.Rodrigues(TURN * np.eye(3)["xyz".index(axis)])
    seen = np.column_stack((px, np.ones(len(px)))) @ (K @ R @ np.linalg.inv(K)).T
    return seen[:, :2] / seen[:, 2:]


def test_rows_of_cameras_turned_about_the_line_of_sight_are_taken_out_and_what_they_leave_open_is_told():
    sight = sight_of(WAVING, 300, 0.1)
    # half the turn in either camera, as a rectification leaves it
    sides = np.where(sight.eye == 0, -0.5, 0.5)[:, None]
    sight = dataclasses.replace(sight, point_px=sight.point_px + sides * (turned(sight.point_px, "z") - sight.point_px))
    loose = np.diag((np.array(ERRORS) == "roll") * TURN**2)
    fit, exact = (refined(Start(WAVING, sight, of_calibration=known), CAMERA) for known in (loose, 0 * loose))
    assert fit.row_offset_px[1] == pytest.approx(TURN * CAMERA.fx_px, rel=0.4)
    assert not exact.row_offset_px.any()
    assert off(fit.curve, WAVING)[0] < 0.6 * off(exact.curve, WAVING)[0]
    assert exact.row_doubt is None
    assert fit.row_doubt is not None
    assert np.abs(fit.row_doubt).max() > 0


def slowly_off(curve, seed, correlation_px=70.0, alike=0.0):
    """Points of both images, each image's moved across the thread by errors that are alike over so many pixels.

    So much of their deviation is the same in both images.
    """
    sight, rng = sight_of(curve, count=120, noise_px=0.02), np.random.default_rng(seed)
    both = rng.normal(size=120) if alike else np.zeros(120)
    point = sight.point_px.copy()
    for eye in (0, 1):
        here = np.flatnonzero(sight.eye == eye)
        view = projected(curve, sight.s[here], sight.eye[here], CAMERA)
        u, v = view.velocity_px.T
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(view.point_px, axis=0), axis=1))))
        apart = (along[:, None] - along) / correlation_px
        root = np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-8 * np.eye(120))
        error = STATED_PX * root @ (alike * both + np.sqrt(1.0 - alike**2) * rng.normal(size=120))
        point[here] += error[:, None] * np.column_stack((-v, u)) / np.hypot(u, v)[:, None]
    return dataclasses.replace(sight, point_px=point, deviation_px=np.full(240, STATED_PX))


def inside(fit, truth):
    """The share of places where the thread lies within the 95 % ellipse."""
    points, tangents = fit.curve.derivatives(WITHIN)[:2]
    covariance = point_covariance(fit, CAMERA, WITHIN)
    return normal_errors(points, tangents, covariance, truth.at(np.linspace(0, 1, 4000))).inside.mean()


def test_slow_errors_of_each_image_lie_within_the_ellipses_though_residuals_hide_them():
    shares, without, scales = [], [], []
    for seed in range(4):
        fit = refined(Start(WAVING, slowly_off(WAVING, seed)), CAMERA)
        certain = dataclasses.replace(fit.sight, deviation_px=np.full(240, 1e-3), width_px=0.0)
        scales.append(fit.scale)
        shares.append(inside(fit, WAVING))
        without.append(inside(dataclasses.replace(fit, sight=certain), WAVING))
    assert max(scales) < 0.5
    assert np.mean(without) < 0.7
    assert 0.88 <= np.mean(shares) <= 0.995


def test_errors_of_pixels_are_not_shared_but_depth_is_less_sure_along_the_rows_and_where_a_thread_turns():
    exact = np.zeros((len(ERRORS), len(ERRORS)))
    fit = refined(Start(WAVING, sight_of(WAVING, 300, 0.02, 0.02), of_calibration=exact), CAMERA)
    assert not shared_errors(fit, CAMERA).any()
    said = point_covariance(fit, CAMERA, WITHIN)
    x, y, z = WAVING.at(WITHIN).T
    slope = np.abs(np.gradient(y / z) / np.gradient(x / z))
    depth = np.sqrt(said[:, 2, 2])
    assert np.median(depth[slope < 0.05]) > 1.5 * np.median(depth[slope > 0.8])
    wide = dataclasses.replace(fit, sight=dataclasses.replace(fit.sight, width_px=30.0))
    ratio = np.trace(point_covariance(wide, CAMERA, WITHIN), axis1=1, axis2=2) / np.trace(said, axis1=1, axis2=2)
    assert ratio.max() > 1.1
    assert ratio.min() >= 1 - 1e-9


OUT = 0.2
"""Share of the way that goes past the end and back again."""


def only(sight, chosen):
    arrays = (getattr(sight, name)[chosen] for name in ("point_px", "deviation_px", "eye", "s", "is_end"))
    return Sightings(*arrays)


def test_a_curve_that_leaves_the_thread_and_comes_back_is_cut_short_unless_both_eyes_support_it():
    """It goes past the thread's first end and returns, with the thread's points on what follows."""
    t = np.linspace(0, 1, 5 * 43)
    out = np.clip(t / OUT, 0, 1)
    place = np.where(t < OUT, -0.1 * np.sin(np.pi * out), (t - OUT) / (1 - OUT))
    points = winding(place) + np.where(t < OUT, 0.4 * np.sin(2 * np.pi * out), 0.0)[:, None]
    curve = Curve(clamped_uniform_knots(43), fitted(40, points))
    sight = sight_of(curve, 200)
    at_end, after = sight.s == 0, sight.s > OUT + 0.01
    for eye in (0, 1):
        # an end that one eye shows does not support the way out and back
        seen = only(sight, after | (at_end & (sight.eye == eye)))
        (fold,) = folds(seen, curve, CAMERA)
        assert fold == pytest.approx((0, OUT), abs=0.02)
        without, _ = at_constant_speed(curve, seen.s, folds(seen, curve, CAMERA))
        lengths = [np.linalg.norm(np.diff(c.at(DENSE), axis=0), axis=1).sum() for c in (without, curve)]
        assert lengths[0] < 0.9 * lengths[1]
    assert len(folds(only(sight, at_end | after), curve, CAMERA)) == 1
    for supported_or_straight in (sight, only(sight, (sight.s < 0.5) | (sight.s > 0.8))):
        assert folds(supported_or_straight, curve, CAMERA).shape == (0, 2)
