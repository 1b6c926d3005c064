"""Method paper from observations to the message, and every way in which it fails."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from agents.reconstruction import minimum_variation, paper
from agents.reconstruction.method_names import MATCHING_METHODS, METHOD_NAMES
from agents.reconstruction.methods import METHODS
from agents.reconstruction.minimum_variation import MinimumVariationSpline
from agents.reconstruction.paper import METHOD, reconstruct_paper
from agents.reconstruction.plausibility import MOST_OBSERVATIONS, contradiction, implausible
from schemas.codec import encode
from schemas.messages import Status
from shared.arc_length import even_parameters, length
from shared.camera import backproject, project
from shared.splines import clamped_uniform_knots, evaluate

SHARE = np.linspace(0, 1, 60)
KNOTS = clamped_uniform_knots(20)


def with_whole_disparities(camera, points):
    """What a matcher that counts pixels makes of these points."""
    left_px, right_px = project(camera, points)
    disparity_px = np.round(left_px[:, 0] - right_px[:, 0])
    return backproject(camera, left_px, camera.fx_px * camera.baseline / disparity_px)


def points_of(reconstruction, count=400):
    knots, P = reconstruction.knots, reconstruction.control_points_camera
    return evaluate(knots, P, 3, even_parameters(knots, P, 3, count))


def curve_error(reconstruction, thread):
    distance = cdist(points_of(reconstruction, 1000), thread.at(np.linspace(0, 1, 1000)))
    return max(distance.min(axis=0).max(), distance.min(axis=1).max())


def test_exact_observations_give_the_thread_they_were_taken_from_each_time(observe, thread, check_sound):
    observations = observe(thread.at(SHARE))
    reconstruction = reconstruct_paper(observations)
    check_sound(reconstruction, observations)
    assert reconstruction.status is Status.OK
    assert curve_error(reconstruction, thread) < 0.5
    assert not reconstruction.regions.slack.any()
    assert (reconstruction.confidence == 1).all()
    assert encode(reconstruct_paper(observations)) == encode(reconstruction)


def test_whole_pixels_of_disparity_give_a_thread_within_one_of_them(camera, observe, thread, check_sound):
    observations = observe(with_whole_disparities(camera, thread.at(SHARE)))
    reconstruction = reconstruct_paper(observations)
    check_sound(reconstruction, observations)
    assert curve_error(reconstruction, thread) < 95**2 / (camera.fx_px * camera.baseline)


@pytest.mark.parametrize("factor", [1e-20, 40.0, 1e20])
def test_the_unit_of_the_calibration_changes_nothing_but_the_scale(camera, observe, thread, factor):
    points = with_whole_disparities(camera, thread.at(SHARE))
    other = dataclasses.replace(camera, baseline=camera.baseline * factor, metres_per_unit=1e-3 / factor)
    here = reconstruct_paper(observe(points))
    there = reconstruct_paper(observe(factor * points, other))
    scaled = dataclasses.replace(there, control_points_camera=there.control_points_camera / factor)
    assert np.abs(points_of(scaled) - points_of(here)).max() < 1e-3
    assert np.allclose(there.confidence, here.confidence, atol=1e-3)


def test_confidence_falls_where_depths_are_noisy(observe, thread):
    noise = np.where(SHARE > 0.6, np.random.default_rng(0).normal(0, 0.05, 60), 0)
    reconstruction = reconstruct_paper(observe(thread.at(SHARE) * (1 + noise)[:, None], half_size_px=6.0))
    assert reconstruction.status is Status.OK
    assert reconstruction.confidence[:45].min() > 0.99
    assert reconstruction.confidence[65:].max() < 0.9


def test_confidence_without_a_unit_takes_the_median_depth_for_the_working_distance(camera, observe, thread):
    points = with_whole_disparities(camera, thread.at(SHARE))
    unitless = dataclasses.replace(camera, metres_per_unit=None)
    at_that_distance = dataclasses.replace(camera, metres_per_unit=0.1 / float(np.median(points[:, 2])))
    one, other = (reconstruct_paper(observe(points, of)).confidence for of in (unitless, at_that_distance))
    assert np.array_equal(one, other)


def test_a_gap_between_observations_is_an_unseen_stretch_of_that_arc_length(observe, thread, check_sound):
    share = np.concatenate((np.linspace(0, 0.4, 30), np.linspace(0.55, 1, 30)))
    observations = observe(thread.at(share), gaps=np.array([29]))
    reconstruction = reconstruct_paper(observations)
    check_sound(reconstruction, observations)
    assert np.allclose(reconstruction.unseen, [[0.4, 0.55]], atol=0.01)


def test_it_goes_by_its_name():
    assert METHODS["paper"] is reconstruct_paper
    assert METHOD in MATCHING_METHODS
    assert set(METHOD_NAMES) == set(METHODS)


def reason_of(observations):
    reconstruction = reconstruct_paper(observations)
    assert reconstruction.status is Status.FAILED
    return reconstruction.reason


def test_observations_that_are_no_thread_are_refused_with_the_reason(observe, thread):
    nothing = np.zeros((0, 3))
    assert reason_of(observe(nothing, status=Status.FAILED, reason="it is dark in here")) == "it is dark in here"
    assert "set matching = true in [perception]" in reason_of(observe(nothing))
    assert "3 observations are too few" in reason_of(observe(thread.at(SHARE[:3])))
    assert "too many" in reason_of(observe(thread.at(np.linspace(0, 1, MOST_OBSERVATIONS + 1))))
    assert reason_of(observe(np.tile([1.0, 2.0, 90.0], (9, 1)))) == "all observations are at one place"
    points = np.concatenate((thread.at(SHARE), thread.at(SHARE[::-1]) * 1.15, thread.at(SHARE)))[::7]
    shuffled = np.random.default_rng(0).permutation(points)
    assert "observations contradict the others" in reason_of(observe(shuffled))


@pytest.mark.parametrize("factor", [1e-35, 1e35])
def test_depths_that_cannot_be_computed_with_are_refused(camera, observe, thread, factor):
    other = dataclasses.replace(camera, baseline=camera.baseline * factor)
    assert "calibration's unit" in reason_of(observe(factor * thread.at(SHARE), other))


@pytest.mark.parametrize("change", [[1e4, 0, 0], [0, -1e4, 0], [0, 0, 1e9], [0, 0, -90.0]])
def test_an_observation_that_no_camera_can_have_seen_is_named(observe, thread, change):
    points = thread.at(SHARE)
    points[17] += change
    points[17, 2] = max(points[17, 2], 1e-3)
    assert "observation 17 cannot have been seen by this camera" in reason_of(observe(points))


def test_observations_of_another_calibration_are_refused(camera, observe, thread):
    other = dataclasses.replace(camera, fx_px=1e200, baseline=1e200)
    assert "check that its calibration is the images' own" in reason_of(observe(thread.at(SHARE), other))


def test_a_program_that_is_not_solved_is_a_failure_with_the_solvers_word(observe, thread, monkeypatch):
    monkeypatch.setattr(minimum_variation, "MOST_ITERATIONS", 1)
    assert "solver: max iter reached" in reason_of(observe(thread.at(SHARE)))


@pytest.mark.parametrize(
    ("distort", "reason"),
    [
        (lambda P: np.full_like(P, np.nan), "not finite"),
        (lambda P: P - [0, 0, 100], "behind the camera"),
        (lambda P: P * np.where(np.arange(20) % 2, 5, 1)[:, None] * [1, 1, 0] + P * [0, 0, 1], "times as long"),
    ],
)
def test_a_curve_that_cannot_be_the_thread_is_a_failure(observe, thread, monkeypatch, distort, reason):
    spline = paper.minimum_variation_spline

    def distorted(*arguments):
        found = spline(*arguments)
        return dataclasses.replace(found, control_points_camera=distort(found.control_points_camera))

    monkeypatch.setattr(paper, "minimum_variation_spline", distorted)
    assert reason in reason_of(observe(thread.at(SHARE)))


def spline_with(slack, P):
    return MinimumVariationSpline(KNOTS, P, np.linspace(0, 1, len(slack)), slack)


def test_a_tenth_of_the_regions_may_be_missed_and_no_more():
    slack = np.concatenate((np.full(5, 1.5), np.full(15, 0.9), np.zeros(30)))
    assert contradiction(spline_with(slack, np.zeros((20, 3)))) == ""
    slack[5] = 1.1
    assert contradiction(spline_with(slack, np.zeros((20, 3)))).startswith("6 of 50 observations contradict")


def test_a_curve_three_times_as_long_as_its_chords_is_an_accident(thread):
    P, points = thread.control_points, thread.at(np.array([0.2, 0.25]))
    long = length(KNOTS, P, 3) / np.linalg.norm(points[1] - points[0])
    assert implausible(spline_with(np.zeros(2), P), points).startswith(f"the curve is {long:.1f} times as long")
    assert implausible(spline_with(np.zeros(2), P), thread.at(np.array([0, 1]))) == ""
