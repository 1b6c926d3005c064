import numpy as np
import pytest
from numpy.polynomial.legendre import legval
from scipy.stats import special_ortho_group

from benchmarks.bounds import bound, mean_distance, normal_frame, sensitivity
from benchmarks.centre_noise import centroid_noise_px, pixel_noise_px
from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.splines import basis_matrix, clamped_uniform_knots

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
    random = np.random.default_rng(0)
    spread = np.array([np.diag([4.0, 0.01]), np.diag([2.0, 2.0]), [[1.0, 0.6], [0.6, 0.5]]])
    sampled = [np.linalg.norm(random.multivariate_normal([0, 0], s, 400_000), axis=1).mean() for s in spread]
    assert mean_distance(spread) == pytest.approx(sampled, rel=0.005)


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


def test_the_frame_is_orthonormal_and_normal_to_the_curve():
    curve = arc() @ special_ortho_group.rvs(3, random_state=0)
    frame, tangent = normal_frame(curve), np.gradient(curve, axis=0)
    assert np.einsum("nki,nli->nkl", frame, frame) == pytest.approx(np.tile(np.eye(2), (len(curve), 1, 1)))
    assert np.abs(np.einsum("nki,ni->nk", frame, tangent)).max() < 1e-9


@pytest.mark.parametrize("eye", [0, 1])
def test_sensitivity_is_the_derivative_of_the_distance_across_the_projected_thread(eye):
    truth = arc(400)
    knots = clamped_uniform_knots(12)
    N = basis_matrix(knots, 3, np.linspace(0, 1, 400))
    normals = normal_frame(truth)
    J = sensitivity(CAMERA, truth, eye, N, normals)
    px = project(CAMERA, truth)[eye]
    tangent = np.gradient(px, axis=0)
    across = np.column_stack((-tangent[:, 1], tangent[:, 0])) / np.linalg.norm(tangent, axis=1)[:, None]
    change = np.random.default_rng(1).normal(0, 1e-5, 24)
    moved = truth + np.einsum("nk,nki->ni", np.column_stack((N @ change[:12], N @ change[12:])), normals)
    shift = np.sum(across * (project(CAMERA, moved)[eye] - px), axis=1)
    assert J @ change == pytest.approx(shift, rel=1e-3, abs=1e-8)


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


def stripe(sigma, noise, seed=0):
    """An upright dark line of a Gaussian profile in white noise, and its centreline."""
    u = np.arange(60.0)
    profile = 200 - 100 * np.exp(-0.5 * ((u - 30.2) / sigma) ** 2)
    image = np.tile(profile, (400, 1)) + np.random.default_rng(seed).normal(0, noise, (400, 60))
    line = np.column_stack((np.full(800, 30.2), np.linspace(5, 395, 800)))
    return np.rint(image).astype(np.uint8)[..., None].repeat(3, axis=2), line


def test_the_noise_of_pixels_is_the_bound_of_a_shift():
    image, line = stripe(1.5, 3.0)
    expected = 3.0 / np.sqrt(100**2 * np.sqrt(np.pi) / (2 * 1.5))
    found = pixel_noise_px(image, line, np.ones(800, bool))
    assert np.median(found) == pytest.approx(expected, rel=0.15)


def test_the_noise_of_centroids_is_their_scatter_and_no_slow_deviation():
    random = np.random.default_rng(2)
    shift = random.normal(0, 0.3, 400) + 0.5 * np.sin(np.linspace(0, 6, 400))
    mask = np.rint(255 * np.exp(-0.5 * ((np.arange(60.0) - 30 - shift[:, None]) / 1.5) ** 2)).astype(np.uint8)
    line = np.column_stack((np.full(800, 30.0), np.linspace(5, 395, 800)))
    visible = np.linspace(0, 1, 800) < 0.9
    found = centroid_noise_px(mask, line, visible)
    known = found[np.isfinite(found)]
    # lines half-way between rows average two of them
    assert known[0] == pytest.approx(0.3 / np.sqrt(2), rel=0.25)
    assert (known == known[0]).all()
    assert len(known) == pytest.approx(0.9 * 390, abs=3)
