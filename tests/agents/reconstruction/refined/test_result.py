"""From a fit to what is told: regions that hold the curve, confidence, unseen stretches."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import dblquad
from scipy.stats import norm

from agents.reconstruction.minimum_variation import Regions
from agents.reconstruction.refined.constraints import held_to
from agents.reconstruction.refined.refinement import Start, refined
from agents.reconstruction.refined.result import TOLERANCE_M, confidence_of, stretches
from shared.camera import project
from tests.agents.reconstruction.threads import CAMERA, sight_of, spline_of, winding

AT, ALONG_X = np.linspace(0.1, 0.9, 9), np.array([[1.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def fit():
    spline = spline_of(winding)
    return refined(Start(spline, sight_of(spline)), CAMERA)


def regions_about(curve, push=(0.0, 0.0, 0.0)):
    return Regions(curve.at(AT) + push, np.full((9, 2), 2.0), np.full(9, 0.5))


def outside(regions, curve):
    """How far the curve is outside of each region, by projection, as a multiple of its bounds; negative inside."""
    points = curve.at(AT)
    off_px = np.abs(project(CAMERA, points)[0] - project(CAMERA, regions.centre_camera)[0]) / regions.bound_px
    off_depth = np.abs(points[:, 2] - regions.centre_camera[:, 2]) / regions.bound_depth
    return np.maximum(off_px.max(axis=1), off_depth) - 1


def test_regions_hold_the_curve_as_far_as_its_points_do_not_contradict(fit):
    """What the images tell nothing of gives way to the regions: with little data the curve is wherever they say."""
    held = held_to(regions_about(fit.curve), AT, fit.curve, fit.total, CAMERA)
    np.testing.assert_array_equal(held.curve.control_points, fit.curve.control_points)
    assert not held.slack.any()
    regions = regions_about(fit.curve, push=(0.0, 0.0, 1.0))
    assert outside(regions, fit.curve).max() > 0.5
    held = held_to(regions, AT, fit.curve, fit.total * 1e-6, CAMERA)
    assert outside(regions, held.curve).max() < 1e-4
    assert held.slack.max() < 1e-4
    # many points contradict one region, which gives way
    centre = fit.curve.at(AT) + (np.arange(9) == 4)[:, None] * [0.0, 0.0, 20.0]
    regions = dataclasses.replace(regions, centre_camera=centre)
    held = held_to(regions, AT, fit.curve, fit.total, CAMERA)
    assert np.abs(held.curve.control_points - fit.curve.control_points).max() < 1.0
    assert held.slack.argmax() == 4
    assert held.slack[4] == pytest.approx(outside(regions, held.curve)[4], rel=0.05)


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
