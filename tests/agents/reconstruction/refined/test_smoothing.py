"""Marginal likelihood and local weights against dense formulas."""

import numpy as np
import pytest

from agents.reconstruction.refined.normal_equations import (
    damping_blocks,
    data_blocks,
    gradient,
    linearised,
    roughness_blocks,
    third_differences,
)
from agents.reconstruction.refined.projection import LEVEL
from agents.reconstruction.refined.smoothing import (
    LEAST_WEIGHT,
    MOST_WEIGHT,
    PRIOR_COUNT,
    WINDOW_SPANS,
    chosen_smoothing,
    local_weights,
    log_evidence,
)

LAMBDAS = (1e-1, 1e1, 1e3, 1e5)


@pytest.fixture(params=[0.0, 0.2], ids=["exact", "noisy"])
def data(request, spline, sight_of, camera):
    rows = linearised(spline, sight_of(spline, noise_px=request.param), camera, LEVEL)
    return data_blocks(rows, np.ones(len(rows.residual)), spline.spans) + damping_blocks(spline)


def dense_evidence(dense, spline, data, unit, smoothing):
    """½ k log λ − ½ log |H + λA| − the least of data and prior together."""
    H, A, P = dense(data.H), dense(unit.H), spline.control_points.ravel()
    M, g = H + smoothing * A, gradient(data.g) + smoothing * A @ P
    least = 0.5 * smoothing * P @ A @ P - 0.5 * g @ np.linalg.solve(M, g)
    return 1.5 * spline.spans * np.log(smoothing) - 0.5 * np.linalg.slogdet(M)[1] - least


def test_evidence_is_the_dense_formula_and_the_most_probable_smoothing_is_chosen(spline, data, dense):
    for weight in (np.random.default_rng(1).uniform(0.2, 5, spline.spans), np.ones(spline.spans)):
        unit = roughness_blocks(spline, weight)
        evidence = log_evidence(spline, data, unit)
        found = [evidence(smoothing) for smoothing in LAMBDAS]
        wanted = [dense_evidence(dense, spline, data, unit, smoothing) for smoothing in LAMBDAS]
        np.testing.assert_allclose(np.diff(found), np.diff(wanted), rtol=1e-5, atol=1e-4)
        assert chosen_smoothing(spline, data, weight, np.array(LAMBDAS)) == LAMBDAS[int(np.argmax(wanted))]
    # equations without a solution are never the most probable
    assert log_evidence(spline, data * -1.0, unit)(1.0) == -np.inf


def test_local_weights_are_mackays_fixed_point(spline, data, dense):
    weight, smoothing = np.random.default_rng(4).uniform(0.5, 2, spline.spans), 30.0
    total = data + roughness_blocks(spline, smoothing * weight)
    D = np.kron(third_differences(spline.spans) / spline.size, np.eye(3))
    variance = np.diag(D @ np.linalg.inv(dense(total.H)) @ D.T).reshape(-1, 3).sum(axis=1)
    determined = np.clip(3 - smoothing * weight * variance, 0, 3)
    bend = ((D @ spline.control_points.ravel()) ** 2).reshape(-1, 3).sum(axis=1)
    k = np.arange(spline.spans)
    window = np.exp(-0.5 * ((k[:, None] - k) / WINDOW_SPANS) ** 2)
    wanted = (window @ determined + PRIOR_COUNT) / (window @ (smoothing * bend) + PRIOR_COUNT)
    found = local_weights(spline, total, smoothing, weight)
    np.testing.assert_allclose(found, np.clip(wanted, LEAST_WEIGHT, MOST_WEIGHT), rtol=1e-5)


def test_where_the_thread_is_bent_more_it_is_smoothed_less(spline, data):
    bump = 2.0 * np.exp(-0.5 * ((np.arange(spline.spans + 3) - 6) / 0.7) ** 2)
    bent = spline.moved(bump[:, None] * np.array([1.0, 0.0, 0.0]))
    weight = np.ones(spline.spans)
    found = local_weights(bent, data + roughness_blocks(bent, 3e3 * weight), 3e3, weight)
    assert found[3:7].max() < 0.3 * found[14:].min()
