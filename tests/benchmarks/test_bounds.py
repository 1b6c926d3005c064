import numpy as np
import pytest
from numpy.polynomial.legendre import legval

from benchmarks.bounds import bound, mean_distance
from schemas.messages import RectifiedStereo
from shared.camera import project

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)


def arc(count=1500):
    t = np.linspace(0, 2.0, count)
    return np.column_stack((12 * np.cos(t), 12 * np.sin(t), 90 + 3 * t))


def seen(truth):
    return np.ones((len(truth), 2), bool)


def even_noise(truth, sigma):
    left, right = (np.linalg.norm(np.diff(px, axis=0), axis=1).sum() for px in project(CAMERA, truth))
    return np.full(int(left), sigma), np.full(int(right), sigma)


def test_the_mean_distance_of_a_normal_variable_is_that_of_many_samples():
    spread = np.array([np.diag([4.0, 0.01]), [[1.0, 0.6], [0.6, 0.5]]])
    random = np.random.default_rng(0)
    sampled = [np.linalg.norm(random.multivariate_normal([0, 0], s, 100_000), axis=1).mean() for s in spread]
    assert mean_distance(spread) == pytest.approx(sampled, rel=0.01)


def test_a_straight_upright_thread_is_bounded_by_the_regression_of_parabolas():
    """Straight means no third differences, so the estimate is a parabola in x and in z, pixel row by pixel row."""
    depth, sigma, rows = 100.0, 0.1, 300
    v = np.linspace(-0.5, 0.5, 1501)
    truth = np.column_stack((np.zeros(1501), v * rows * depth / 1000.0, np.full(1501, depth)))
    found = bound(CAMERA, truth, seen(truth), even_noise(truth, sigma))
    leverage = sum((2 * k + 1) * legval(2 * v, np.eye(3)[k]) ** 2 for k in range(3)) / rows
    # x follows from the left image alone, z from the difference of both: covariances are sums over both images
    to_x, to_z = depth / 1000.0, depth**2 / (1000.0 * 5.5)
    spread = sigma**2 * np.array([[to_x**2, to_x * to_z], [to_x * to_z, 2 * to_z**2]])
    expected = np.mean(np.sqrt(leverage)) * mean_distance(spread[None])[0]
    assert found.whole == pytest.approx(expected, rel=0.02)
    assert found.seen == found.whole


def test_more_noise_and_hidden_stretches_raise_the_bound():
    truth = arc()
    clear = bound(CAMERA, truth, seen(truth), even_noise(truth, 0.05))
    assert bound(CAMERA, truth, seen(truth), even_noise(truth, 0.2)).whole > 2 * clear.whole
    hidden = seen(truth)
    hidden[500:1000] = False
    covered = bound(CAMERA, truth, hidden, even_noise(truth, 0.05))
    assert covered.whole > clear.whole
    assert covered.seen is not None
    assert covered.seen < covered.whole
