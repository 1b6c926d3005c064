"""From a fit to what is told: regions that the curve misses, confidence, unseen stretches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import dblquad
from scipy.stats import norm

from agents.reconstruction.minimum_variation import Regions
from agents.reconstruction.refined.regions import slack_of
from agents.reconstruction.refined.result import TOLERANCE_M, confidence_of, stretches
from shared.camera import project
from tests.agents.reconstruction.threads import CAMERA, spline_of, winding

AT, ALONG_X = np.linspace(0.1, 0.9, 9), np.array([[1.0, 0.0, 0.0]])


def test_a_region_that_the_curve_misses_has_slack_by_its_own_bounds():
    curve = spline_of(winding)
    push = (np.arange(9) == 4)[:, None] * [0.0, 0.0, 2.0] + (np.arange(9) == 6)[:, None] * [1.0, 0.0, 0.0]
    regions = Regions(curve.at(AT) + push, np.full((9, 2), 2.0), np.full(9, 0.5))
    slack = slack_of(regions, AT, curve, CAMERA)
    np.testing.assert_allclose(np.delete(slack, (4, 6)), 0.0)
    points = curve.at(AT)
    off_px = np.abs(project(CAMERA, points)[0] - project(CAMERA, regions.centre_camera)[0]) / regions.bound_px
    off_depth = np.abs(points[:, 2] - regions.centre_camera[:, 2]) / regions.bound_depth
    outside = np.maximum(off_px.max(axis=1), off_depth)[[4, 6]] - 1
    np.testing.assert_allclose(slack[[4, 6]], outside, rtol=0.05)


@pytest.mark.parametrize("unit_m", [1.0, 1e-3])
def test_confidence_is_the_probability_of_being_within_the_tolerance_across_the_thread(unit_m):
    deviation = np.array([7.0, 0.8, 1.3]) * TOLERANCE_M / unit_m
    (found,) = confidence_of(ALONG_X, np.diag(deviation**2)[None], unit_m)

    def density(radius, angle):
        """Of the normal distribution over the disc, ring by ring."""
        across = norm.pdf(radius * np.cos(angle), scale=0.8) * norm.pdf(radius * np.sin(angle), scale=1.3)
        return radius * across

    assert found == pytest.approx(dblquad(density, 0.0, 2 * np.pi, 0.0, 1.0)[0], rel=1e-8)


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
