"""What neighbouring points of an image err together is part of what is told, by what it does to the curve."""

import dataclasses

import numpy as np

from agents.reconstruction.refined.posterior import point_covariance
from agents.reconstruction.refined.projection import projected
from agents.reconstruction.refined.refinement import Start, refined
from agents.reconstruction.refined.shared_errors import shared_errors
from shared.curve_distance import normal_errors

WITHIN = np.linspace(0.02, 0.98, 200)
STATED_PX = 0.2


def slowly_off(curve, sight, camera, rng, correlation_px=70.0, alike=0.0):
    """The same points, each image's moved across the thread by errors that are alike over so many pixels.

    So much of their deviation is the same in both images.
    """
    points = int((sight.eye == 0).sum())
    both = rng.normal(size=points) if alike else np.zeros(points)
    point = sight.point_px.copy()
    for eye in (0, 1):
        here = np.flatnonzero(sight.eye == eye)
        view = projected(curve, sight.s[here], sight.eye[here], camera)
        u, v = view.velocity_px.T
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(view.point_px, axis=0), axis=1))))
        apart = (along[:, None] - along) / correlation_px
        error = (
            STATED_PX
            * np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-8 * np.eye(len(along)))
            @ (alike * both + np.sqrt(1.0 - alike**2) * rng.normal(size=len(along)))
        )
        point[here] += error[:, None] * np.column_stack((-v, u)) / np.hypot(u, v)[:, None]
    return dataclasses.replace(sight, point_px=point, deviation_px=np.full(len(point), STATED_PX))


def test_slow_errors_of_each_image_lie_within_the_ellipses_though_residuals_hide_them(waving_spline, sight_of, camera):
    inside, inside_without, scales = [], [], []
    truth = waving_spline.at(np.linspace(0, 1, 4000))
    for seed in range(4):
        sight = sight_of(waving_spline, count=120, noise_px=0.02)
        off = slowly_off(waving_spline, sight, camera, np.random.default_rng(seed))
        fit = refined(Start(waving_spline, off), camera)
        scales.append(fit.scale)
        places = fit.curve.derivatives(WITHIN)[:2]
        covariance = point_covariance(fit, camera, WITHIN)
        inside.append(normal_errors(*places, covariance, truth).inside.mean())
        certain = dataclasses.replace(fit.sight, deviation_px=np.full(len(off.s), 1e-3), width_px=0.0)
        without = point_covariance(dataclasses.replace(fit, sight=certain), camera, WITHIN)
        inside_without.append(normal_errors(*places, without, truth).inside.mean())
    assert max(scales) < 0.5
    assert np.mean(inside_without) < 0.7
    assert 0.88 <= np.mean(inside) <= 0.995


def beside_rows(t):
    """A thread that nowhere climbs by more than a tenth."""
    return np.column_stack((-24 + 48 * t, 3.0 * (t - 0.5) + np.sin(5 * t), 92 + 2 * np.cos(4 * t)))


def test_what_both_eyes_err_alike_along_the_rows_leaves_depth_better_known(make_spline, sight_of, camera):
    curve = make_spline(beside_rows, 24)
    truth = curve.at(np.linspace(0, 1, 4000))
    inside, said_mm, off_mm = [], [], []
    for seed in range(2):
        sight = sight_of(curve, count=120, noise_px=0.02)
        off = slowly_off(curve, sight, camera, np.random.default_rng(seed), alike=0.97)
        fit = refined(Start(curve, off), camera)
        place = fit.curve.derivatives(WITHIN)
        covariance = point_covariance(fit, camera, WITHIN)
        inside.append(normal_errors(*place[:2], covariance, truth).inside.mean())
        said_mm.append(np.sqrt(np.mean(covariance[:, 2, 2])))
        off_mm.append(np.sqrt(np.mean((place[0] - curve.at(WITHIN))[:, 2] ** 2)))
    assert np.mean(inside) >= 0.85
    assert np.mean(said_mm) < 3.0 * np.mean(off_mm)


def test_errors_of_pixels_are_not_shared_but_a_thread_that_turns_within_its_width_is_less_sure(
    waving_spline, sight_of, camera
):
    fit = refined(Start(waving_spline, sight_of(waving_spline, noise_px=0.02, deviation_px=0.02)), camera)
    assert not shared_errors(fit, camera).any()
    wide = dataclasses.replace(fit, sight=dataclasses.replace(fit.sight, width_px=30.0))
    said, more = (np.trace(point_covariance(f, camera, WITHIN), axis1=1, axis2=2) for f in (fit, wide))
    assert (more > 1.1 * said).any()
    assert (more >= said * (1 - 1e-9)).all()
