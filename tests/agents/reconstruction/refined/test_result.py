"""From a fit to what is told: confidence, unseen stretches, and which end is the first."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import dblquad
from scipy.stats import norm

from agents.reconstruction.refined.cubic import fitted
from agents.reconstruction.refined.posterior import point_covariance, sliding
from agents.reconstruction.refined.projection import Curve
from agents.reconstruction.refined.refinement import Start, refined
from agents.reconstruction.refined.result import TOLERANCE_M, confidence_of, guessed_share, stretches
from shared.splines import clamped_uniform_knots

ALONG_X = np.array([[1.0, 0.0, 0.0]])


@pytest.mark.parametrize("unit_m", [1.0, 1e-3])
def test_confidence_is_the_probability_of_being_within_the_tolerance_across_the_thread(unit_m):
    deviation = np.array([7.0, 0.8, 1.3]) * TOLERANCE_M / unit_m
    (found,) = confidence_of(ALONG_X, np.diag(deviation**2)[None], unit_m)
    # the mass of the normal distribution over the disc, ring by ring
    expected, _ = dblquad(
        lambda radius, angle: (
            radius * norm.pdf(radius * np.cos(angle), scale=0.8) * norm.pdf(radius * np.sin(angle), scale=1.3)
        ),
        0.0,
        2 * np.pi,
        0.0,
        1.0,
    )
    assert found == pytest.approx(expected, rel=1e-8)


def test_confidence_of_a_round_distribution_is_known_and_uncertainty_along_the_thread_costs_nothing():
    for deviation in (0.001, 0.11, 0.3, 1.0, 4.0, 1000.0):
        (found,) = confidence_of(ALONG_X, (deviation * TOLERANCE_M) ** 2 * np.eye(3)[None], 1.0)
        assert found == pytest.approx(1 - np.exp(-0.5 / deviation**2), abs=1e-6)
    along, across = np.diag([1.0, 1e-10, 1e-10])[None], np.diag([1e-10, 1.0, 1e-10])[None]
    assert confidence_of(ALONG_X, along, 1.0)[0] > 0.999
    assert confidence_of(ALONG_X, across, 1.0)[0] < 0.01


@given(arrays(bool, st.integers(1, 60)))
def test_stretches_cover_just_the_hidden_places(hidden):
    found = stretches(hidden)
    at = (np.arange(len(hidden)) + 0.5) / len(hidden)
    np.testing.assert_array_equal(((at[:, None] > found[:, 0]) & (at[:, None] < found[:, 1])).any(axis=1), hidden)
    assert (np.diff(found.ravel()) > 0).all()


def test_covariance_grows_where_the_thread_runs_along_the_rows(waving_spline, sight_of, camera):
    # what neighbours err together tilts a crest, and leaves its middle where it is: errors of pixels alone
    sight = sight_of(waving_spline, count=300, noise_px=0.02, deviation_px=0.02)
    fit = refined(Start(waving_spline, sight, of_calibration=np.zeros((8, 8))), camera)
    s = np.linspace(0.03, 0.97, 300)
    depth = np.sqrt(point_covariance(fit, camera, s)[:, 2, 2])
    v = camera.fy_px * waving_spline.at(s)[:, 1] / waving_spline.at(s)[:, 2]
    u = camera.fx_px * waving_spline.at(s)[:, 0] / waving_spline.at(s)[:, 2]
    slope = np.abs(np.gradient(v) / np.gradient(u))
    assert np.median(depth[slope < 0.05]) > 1.5 * np.median(depth[slope > 0.8])


def test_depth_errors_of_a_bent_thread_reach_aside_as_its_moved_circles_do():
    radius, deviation, spans, place = 12.0, 0.7, 30, np.array([0.0, 0.0, 100.0])
    tangent, normal = np.array([1.0, 0.0, 1.0]) / np.sqrt(2), np.array([0.0, 1.0, 0.0])
    angle = np.linspace(-1.0, 1.0, 5 * (spans + 3))[:, None]
    circle = place + radius * (np.sin(angle) * tangent + (1 - np.cos(angle)) * normal)
    curve = Curve(clamped_uniform_knots(spans + 3), fitted(spans, circle))
    across = np.array([0.0, 0.0, 1.0]) - tangent / np.sqrt(2)
    (found,) = sliding(curve, deviation**2 * np.outer(across, across)[None], np.array([0.5]))
    # each circle moved along the line of sight crosses the plane where it is off by this much towards its centre
    slid = np.random.default_rng(0).normal(0, deviation, 200000) / np.sqrt(2)
    aside = radius - np.sqrt(radius**2 - slid**2)
    assert normal @ found @ normal == pytest.approx(np.mean(aside**2), rel=0.05)
    assert np.trace(found) == pytest.approx(normal @ found @ normal, rel=1e-3)


@pytest.mark.parametrize(
    ("unseen", "hidden", "share"),
    [([], None, 0.0), ([(0.2, 0.6)], None, 0.4), ([(0.2, 0.6)], [(0.2, 0.5)], 0.1), ([(0.0, 1.0)], [], 1.0)],
)
def test_what_not_both_eyes_see_though_nothing_hides_it_is_a_guess(unseen, hidden, share):
    thread: Any = SimpleNamespace(
        unseen=np.array(unseen).reshape(-1, 2), hidden=None if hidden is None else np.array(hidden).reshape(-1, 2)
    )
    assert guessed_share(thread) == pytest.approx(share, abs=0.01)
