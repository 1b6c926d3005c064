"""Splines, views, banded equations and what follows from them, against dense matrices and finite differences."""

import numpy as np
import pytest

from agents.reconstruction.refined.following import away_from, band_of, prior
from agents.reconstruction.refined.near_inverse import near_inverse
from agents.reconstruction.refined.normal_equations import (
    Blocks,
    damping_blocks,
    data_blocks,
    gradient,
    linearised,
    roughness_blocks,
    third_differences,
)
from agents.reconstruction.refined.projection import (
    LEVEL,
    Curve,
)
from agents.reconstruction.refined.smoothing import (
    LEAST_WEIGHT,
    MOST_WEIGHT,
    PRIOR_COUNT,
    WINDOW_SPANS,
    chosen_smoothing,
    local_weights,
    log_evidence,
)
from shared.splines import clamped_uniform_knots
from tests.agents.reconstruction.threads import CAMERA, dense, sight_of, spline_of, winding

SPLINE = spline_of(winding)
SPANS = SPLINE.spans


@pytest.mark.parametrize("spans", [1, 4, 9, 40])
def test_of_the_inverse_what_concerns_each_span_is_that_of_the_whole_and_indefinite_is_told(spans):
    rows = np.random.default_rng(spans).normal(size=(spans, 30, 12)) * np.geomspace(1e-2, 1e2, 12)
    blocks = Blocks(rows.transpose(0, 2, 1) @ rows, np.zeros((spans, 12)))
    whole = np.linalg.inv(dense(blocks.H))
    for found, wanted in zip(near_inverse(blocks), by_span(whole), strict=True):
        size = np.sqrt(np.diag(wanted))
        np.testing.assert_allclose(found / np.outer(size, size), wanted / np.outer(size, size), atol=1e-9)
    blocks.H[spans // 2] *= -10.0
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        near_inverse(blocks)


def by_span(matrix):
    """The blocks of the four control points of each span."""
    return np.stack([matrix[k : k + 12, k : k + 12] for k in range(0, len(matrix) - 9, 3)])


@pytest.fixture(params=[0.0, 0.2], ids=["exact", "noisy"])
def data(request):
    rows = linearised(SPLINE, sight_of(SPLINE, noise_px=request.param), CAMERA, LEVEL)
    return data_blocks(rows, np.ones(len(rows.residual)), SPANS) + damping_blocks(SPLINE)


def dense_evidence(data, unit, smoothing):
    """½ k log λ − ½ log |H + λA| − the least of data and prior together."""
    H, A, P = dense(data.H), dense(unit.H), SPLINE.control_points.ravel()
    M, g = H + smoothing * A, gradient(data.g) + smoothing * A @ P
    least = 0.5 * smoothing * P @ A @ P - 0.5 * g @ np.linalg.solve(M, g)
    return 1.5 * SPANS * np.log(smoothing) - 0.5 * np.linalg.slogdet(M)[1] - least


def test_evidence_is_the_dense_formula_and_the_most_probable_smoothing_is_chosen(data):
    smoothings = 1e-1, 1e1, 1e3, 1e5
    weight = np.random.default_rng(1).uniform(0.2, 5, SPANS)
    unit = roughness_blocks(SPLINE, weight)
    found, wanted = log_evidence(SPLINE, data, unit), [dense_evidence(data, unit, each) for each in smoothings]
    np.testing.assert_allclose(np.diff([found(each) for each in smoothings]), np.diff(wanted), rtol=1e-5, atol=1e-4)
    assert chosen_smoothing(SPLINE, data, weight, np.array(smoothings)) == smoothings[int(np.argmax(wanted))]
    # equations without a solution are never the most probable
    assert log_evidence(SPLINE, data * -1.0, unit)(1.0) == -np.inf


def test_local_weights_are_mackays_fixed_point(data):
    weight, smoothing = np.random.default_rng(4).uniform(0.5, 2, SPANS), 30.0
    total = data + roughness_blocks(SPLINE, smoothing * weight)
    D = np.kron(third_differences(SPANS) / SPLINE.size, np.eye(3))
    variance = np.diag(D @ np.linalg.inv(dense(total.H)) @ D.T).reshape(-1, 3).sum(axis=1)
    determined = np.clip(3 - smoothing * weight * variance, 0, 3)
    bend = ((D @ SPLINE.control_points.ravel()) ** 2).reshape(-1, 3).sum(axis=1)
    k = np.arange(SPANS)
    window = np.exp(-0.5 * ((k[:, None] - k) / WINDOW_SPANS) ** 2)
    wanted = (window @ determined + PRIOR_COUNT) / (window @ (smoothing * bend) + PRIOR_COUNT)
    found = local_weights(SPLINE, total, smoothing, weight)
    np.testing.assert_allclose(found, np.clip(wanted, LEAST_WEIGHT, MOST_WEIGHT), rtol=1e-5)


M = 12
STRAIGHT = Curve(clamped_uniform_knots(M), np.column_stack((np.linspace(0, 20.0, M), np.zeros(M), np.full(M, 100.0))))


def test_the_prior_of_a_frame_has_the_covariance_of_neighbours_with_noise_and_draws_back_what_moved_away():
    square = np.random.default_rng(1).normal(size=(3 * M, 3 * M))
    covariance, noise = square @ square.T + np.eye(3 * M), np.array((0.5, 0.4, 0.3, 0.2))
    precision = prior(band_of(by_span(covariance)), noise)
    apart = np.abs(np.subtract.outer(np.arange(M), np.arange(M)))
    wanted = covariance + np.kron(np.where(apart < 4, noise[np.minimum(apart, 3)], 0.0), np.eye(3))
    near = np.kron(apart < 4, np.ones((3, 3))) > 0
    assert np.linalg.inv(dense(precision))[near] == pytest.approx(wanted[near], rel=1e-6, abs=1e-8)
    off = np.random.default_rng(2).normal(size=(M, 3))
    away = away_from(precision, STRAIGHT.moved(off), STRAIGHT)
    assert gradient(away.g) == pytest.approx(dense(precision) @ off.ravel())
