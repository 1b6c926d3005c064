"""The fit against the thread that the points were made from."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.refined.posterior import point_covariance
from agents.reconstruction.refined.refinement import Start, refined
from shared.curve_distance import curve_distance

DENSE = np.linspace(0, 1, 2000)


def disturbed(spline, size=0.15, seed=0):
    """A curve beside the thread, by smooth motions of some pixels."""
    rng, k = np.random.default_rng(seed), np.arange(len(spline.control_points))[:, None]
    waves = sum(rng.normal(0, size, 3) * np.sin(0.4 * (n + 1) * k + rng.uniform(0, 6, 3)) for n in range(3))
    return spline.moved(waves * [1, 1, 4])


@pytest.mark.parametrize("seed", range(2))
def test_exact_points_give_the_thread(spline, sight_of, camera, seed):
    fit = refined(Start(disturbed(spline, seed=seed), sight_of(spline)), camera)
    error = curve_distance(fit.curve.at(DENSE), spline.at(DENSE))
    assert curve_distance(disturbed(spline, seed=seed).at(DENSE), spline.at(DENSE)).maximum > 0.02 * spline.size
    assert error.mean < 1e-3 * spline.size
    assert error.maximum < 4e-3 * spline.size
    assert np.abs(fit.row_offset_px).max() < 0.05


@pytest.mark.parametrize("seed", range(2))
def test_noisy_points_give_it_within_some_of_its_own_deviations(spline, sight_of, camera, seed):
    sight = sight_of(spline, noise_px=0.1, deviation_px=0.1, seed=seed)
    fit = refined(Start(disturbed(spline, seed=seed), sight), camera)
    covariance = point_covariance(fit, camera, DENSE)
    off = fit.curve.at(DENSE) - spline.at(DENSE)
    tangent = np.gradient(spline.at(DENSE), axis=0)
    plane = np.linalg.svd(tangent[:, None, :])[2][:, 1:]
    across = np.einsum("qij,qj->qi", plane, off)
    normal = np.einsum("qij,qjk,qlk->qil", plane, covariance, plane)
    squared = np.einsum("qi,qij,qj->q", across, np.linalg.inv(normal), across)
    assert squared.max() < 25
    assert np.median(squared) > 0.01
    assert 0.6 < fit.scale < 1.4


def test_wrong_points_lose_their_say(spline, sight_of, camera):
    sight = sight_of(spline, noise_px=0.1)
    wrong = np.zeros(len(sight.s), bool)
    wrong[20:28] = wrong[200:206] = True
    spoilt = dataclasses.replace(sight, point_px=sight.point_px + 12.0 * wrong[:, None] * [0.8, 0.6])
    fit = refined(Start(spline, spoilt), camera)
    robust = fit.robust[: fit.rows.sightings]
    assert robust[wrong].max() < 0.1
    assert np.median(robust[~wrong]) > 0.8
    assert curve_distance(fit.curve.at(DENSE), spline.at(DENSE)).mean < 3e-3 * spline.size


def test_a_row_offset_is_found_and_taken_out(waving_spline, sight_of, camera):
    spline, offset_px = waving_spline, -1.2
    fit = refined(Start(spline, sight_of(spline, count=300, noise_px=0.1, row_offset_px=offset_px)), camera)
    assert fit.row_offset_px == pytest.approx(np.array([offset_px, 0, 0, 0]), abs=0.25)
    assert curve_distance(fit.curve.at(DENSE), spline.at(DENSE)).mean < 5e-3 * spline.size


def test_an_offset_that_smoothness_alone_tells_from_depth_is_no_larger_than_a_calibration_allows(
    make_spline, sight_of, camera
):
    """Held far straighter than it is, a thread oblique to the rows would have them off by many pixels."""

    def oblique(t):
        return np.column_stack((-20 + 34 * t + np.sin(5 * t), 16 - 30 * t, 105 + 5 * np.cos(4 * t)))

    spline = make_spline(oblique)
    sight = sight_of(spline, count=400, noise_px=0.1, row_offset_px=0.6)
    sight = dataclasses.replace(sight, is_end=np.zeros(len(sight.s), bool))
    fit = refined(Start(spline, sight, smoothing=1e8, weight=np.ones(spline.spans)), camera, steps=2)
    assert np.abs(fit.row_offset_px).max() < 1.0
