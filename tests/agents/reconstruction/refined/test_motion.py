"""The prior of a frame: what it is, against dense linear algebra."""

import numpy as np
import pytest

from agents.reconstruction.refined.motion import away_from, band_of, prior, process_noise, stretching
from agents.reconstruction.refined.normal_equations import gradient
from agents.reconstruction.refined.projection import Curve
from schemas.messages import RectifiedStereo
from shared.splines import clamped_uniform_knots

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
NO_NOISE = np.zeros(4)
M = 12


@pytest.fixture
def precision(dense):
    """A banded one, of a distribution that is so given by the covariance of neighbours."""
    blocks = np.random.default_rng(0).normal(size=(M - 3, 12, 12))
    return dense(blocks @ blocks.transpose(0, 2, 1)) + np.eye(3 * M)


def by_span(matrix):
    """The blocks of the four control points of each span."""
    return np.stack([matrix[3 * k : 3 * k + 12, 3 * k : 3 * k + 12] for k in range(M - 3)])


def line():
    return Curve(clamped_uniform_knots(M), np.column_stack((np.linspace(0, 20.0, M), np.zeros(M), np.full(M, 100.0))))


def test_the_band_holds_each_control_point_with_the_three_that_follow(precision):
    covariance = np.linalg.inv(precision)
    band, whole = band_of(by_span(covariance)), covariance.reshape(M, 3, M, 3)
    for i in range(M):
        for apart in range(4):
            wanted = whole[i, :, i + apart] if i + apart < M else np.zeros((3, 3))
            assert band[i, apart] == pytest.approx(wanted)


def test_a_distribution_with_banded_precision_comes_back_and_draws_back_what_moved_away(precision, dense):
    blocks = prior(band_of(by_span(np.linalg.inv(precision))), NO_NOISE)
    assert dense(blocks) == pytest.approx(precision, rel=1e-6, abs=1e-6)
    off = np.random.default_rng(2).normal(size=(M, 3))
    away = away_from(blocks, line().moved(off), line())
    assert gradient(away.g) == pytest.approx(dense(blocks) @ off.ravel())


def test_of_any_covariance_the_blocks_of_neighbours_are_kept_and_noise_is_added(dense):
    square = np.random.default_rng(1).normal(size=(3 * M, 3 * M))
    covariance = square @ square.T + np.eye(3 * M)
    noise = np.array((0.5, 0.4, 0.3, 0.2))
    kept = np.linalg.inv(dense(prior(band_of(by_span(covariance)), noise)))
    apart = np.abs(np.subtract.outer(np.arange(M), np.arange(M)))
    wanted = covariance + np.kron(np.where(apart < 4, noise[np.minimum(apart, 3)], 0.0), np.eye(3))
    near = np.kron(apart < 4, np.ones((3, 3))) > 0
    assert kept[near] == pytest.approx(wanted[near], rel=1e-6, abs=1e-8)


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
