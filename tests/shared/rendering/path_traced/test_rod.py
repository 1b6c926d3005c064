"""A rod at rest is what the theory of beams and its own energy say."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from agents.cli.lab.scenes import endoscope
from shared.rendering.path_traced.ground import empty_surface, undulating
from shared.rendering.path_traced.rod import Bed, Held, Rod, _energy, rest_state

ALONG_X = np.array([1.0, 0.0, 0.0])


def straight(count):
    return np.tile(ALONG_X, (count, 1))


def uneven_bed(rng):
    return Bed(undulating(empty_surface(endoscope(960, 540).near_enough, 95.0), rng, {14.0: 1.0}))


def test_a_short_cantilever_sags_as_a_beam_does():
    bearing_length_mm = 60.0
    rod = Rod(0.5, 0.2, bearing_length_mm)
    points = rest_state(rod, Held(np.zeros(3), ALONG_X), straight(60), None)
    # w L⁴ / 8 B, from where it is clamped: half an edge before its first point
    sag = 30.25**4 / (8.0 * bearing_length_mm**3)
    assert points[-1, 2] == pytest.approx(sag, rel=0.03)
    np.testing.assert_allclose(points[:, 1], 0.0, atol=1e-6)


def test_a_rod_that_keeps_a_curvature_lies_as_a_circle():
    rod = Rod(0.5, 0.2, 1e4, kept_curvature=0.05)
    points = rest_state(rod, Held(np.zeros(3), ALONG_X), straight(80), None)
    np.testing.assert_allclose(np.linalg.norm(points[:, :2] - (0.0, 20.0), axis=1), 20.0, atol=0.3)


def test_it_lies_on_the_surface_and_ends_where_it_is_held():
    rng = np.random.default_rng(3)
    bed = uneven_bed(rng)
    start, end = np.array([-20.0, 0.0, 90.0]), np.array([15.0, 5.0, 91.0])
    rod = Rod(0.8, 0.2, 30.0)
    tangents = straight(60) + 0.4 * np.sin(np.linspace(0.0, 6.0, 60))[:, None] * (0.0, 1.0, 0.0)
    points = rest_state(rod, Held(start, ALONG_X, end, ALONG_X), tangents, bed)
    gap = bed.depth(points) - points[:, 2] - rod.radius_mm
    assert gap.min() > -0.1
    assert 0.05 < (gap < 0.1).mean() < 0.9
    assert gap[0] > 1.0
    assert np.linalg.norm(points[-1] - end) < 0.1
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), rod.edge_mm, rtol=1e-9)


def test_the_gradient_is_that_of_the_energy():
    rng = np.random.default_rng(5)
    bed, rod = uneven_bed(rng), Rod(2.0, 0.2, 30.0, kept_curvature=0.03)
    held = Held(np.array([0.0, 0.0, 94.5]), ALONG_X, np.array([9.0, 3.0, 94.0]), ALONG_X)
    flat = (np.tile([0.6, 0.4, 0.05], (14, 1)) + 0.3 * rng.standard_normal((14, 3))).ravel()
    _, gradient = _energy(flat, rod, held, bed)
    numeric = approx_fprime(flat, lambda v: _energy(v, rod, held, bed)[0], 1e-6)
    np.testing.assert_allclose(gradient, numeric, atol=2e-4 * np.abs(numeric).max())
