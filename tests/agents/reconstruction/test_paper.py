"""Method paper: from observations to the message, every way in which it fails, and any observations survived."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.reconstruction import minimum_variation
from agents.reconstruction.minimum_variation import MinimumVariationSpline
from agents.reconstruction.paper import reconstruct_paper
from agents.reconstruction.plausibility import MOST_OBSERVATIONS, contradiction, implausible
from schemas.codec import encode
from schemas.messages import Status
from shared.arc_length import even_parameters, length
from shared.camera import backproject, project
from shared.curve_distance import curve_distance
from shared.splines import clamped_uniform_knots, evaluate
from tests.agents.reconstruction.threads import CAMERA, NOTHING, observed, spline_of

SHARE = np.linspace(0, 1, 60)
KNOTS = clamped_uniform_knots(20)
THREAD = spline_of(lambda t: np.column_stack((-28 + 56 * t, 9 * np.sin(5 * t), 95 + 6 * np.cos(4 * t))), 17)


def with_whole_disparities(points):
    """What a matcher that counts pixels makes of these points."""
    left_px, right_px = project(CAMERA, points)
    disparity_px = np.round(left_px[:, 0] - right_px[:, 0])
    return backproject(CAMERA, left_px, CAMERA.fx_px * CAMERA.baseline / disparity_px)


def points_of(reconstruction):
    knots, P = reconstruction.knots, reconstruction.control_points_camera
    return evaluate(knots, P, 3, even_parameters(knots, P, 3, 1000))


def off_mm(reconstruction):
    return curve_distance(points_of(reconstruction), THREAD.at(np.linspace(0, 1, 1000))).maximum


def sound(observations):
    """The reconstruction, and what must hold of every one beside what its message checks."""
    found = reconstruct_paper(observations)
    assert (found.stamp, found.camera, found.method) == (observations.stamp, observations.camera, "paper")
    if found.status is Status.FAILED:
        assert len(found.reason) > 10
        return found
    assert len(found.control_points_camera) == 20
    assert len(found.regions.s) == len(observations.points_camera)
    assert len(found.confidence) == 100
    assert (found.unseen[:, 0] <= found.unseen[:, 1]).all()
    assert points_of(found)[:, 2].min() > 0
    return found


def test_exact_observations_give_the_thread_they_were_taken_from_each_time():
    observations = observed(THREAD.at(SHARE))
    found = sound(observations)
    assert found.status is Status.OK
    assert off_mm(found) < 0.5
    assert not found.regions.slack.any()
    assert (found.confidence == 1).all()
    assert encode(reconstruct_paper(observations)) == encode(found)


def test_whole_pixels_of_disparity_give_a_thread_within_one_of_them_in_any_unit():
    points = with_whole_disparities(THREAD.at(SHARE))
    here = sound(observed(points))
    assert off_mm(here) < 95**2 / (CAMERA.fx_px * CAMERA.baseline)
    for factor in (1e-20, 40.0, 1e20):
        other = dataclasses.replace(CAMERA, baseline=CAMERA.baseline * factor, metres_per_unit=1e-3 / factor)
        there = reconstruct_paper(observed(factor * points, other))
        scaled = dataclasses.replace(there, control_points_camera=there.control_points_camera / factor)
        assert np.abs(points_of(scaled) - points_of(here)).max() < 1e-3
        assert np.allclose(there.confidence, here.confidence, atol=1e-3)


def test_confidence_falls_where_depths_are_noisy():
    noise = np.where(SHARE > 0.6, np.random.default_rng(0).normal(0, 0.05, 60), 0)
    found = reconstruct_paper(observed(THREAD.at(SHARE) * (1 + noise)[:, None], half_size_px=6.0))
    assert found.confidence[:45].min() > 0.99
    assert found.confidence[65:].max() < 0.9


def test_confidence_without_a_unit_takes_the_median_depth_for_the_working_distance():
    points = with_whole_disparities(THREAD.at(SHARE))
    of_unit = [None, 0.1 / float(np.median(points[:, 2]))]
    cameras = [dataclasses.replace(CAMERA, metres_per_unit=unit_m) for unit_m in of_unit]
    one, other = (reconstruct_paper(observed(points, camera)).confidence for camera in cameras)
    assert np.array_equal(one, other)


def test_a_gap_between_observations_is_an_unseen_stretch_of_that_arc_length():
    share = np.concatenate((np.linspace(0, 0.4, 30), np.linspace(0.55, 1, 30)))
    found = sound(observed(THREAD.at(share), gaps=np.array([29])))
    assert np.allclose(found.unseen, [[0.4, 0.55]], atol=0.01)


def reason_of(observations):
    found = sound(observations)
    assert found.status is Status.FAILED
    return found.reason


def test_observations_that_are_no_thread_are_refused_with_the_reason():
    points = THREAD.at(SHARE)
    assert reason_of(observed(status=Status.FAILED, reason="it is dark in here")) == "it is dark in here"
    assert "set matching = true in [perception]" in reason_of(observed(NOTHING))
    assert "3 observations are too few" in reason_of(observed(points[:3]))
    assert "too many" in reason_of(observed(THREAD.at(np.linspace(0, 1, MOST_OBSERVATIONS + 1))))
    assert reason_of(observed(np.tile([1.0, 2.0, 90.0], (9, 1)))) == "all observations are at one place"
    shuffled = np.random.default_rng(0).permutation(np.concatenate((points, points * 1.15, points))[::7])
    assert "observations contradict the others" in reason_of(observed(shuffled))
    for factor in (1e-35, 1e35):
        other = dataclasses.replace(CAMERA, baseline=CAMERA.baseline * factor)
        assert "calibration's unit" in reason_of(observed(factor * points, other))
    other = dataclasses.replace(CAMERA, fx_px=1e200, baseline=1e200)
    assert "check that its calibration is the images' own" in reason_of(observed(points, other))
    for change in ([1e4, 0, 0], [0, -1e4, 0], [0, 0, 1e9], [0, 0, 1e-3 - points[17, 2]]):
        moved = points + (np.arange(60) == 17)[:, None] * change
        assert "observation 17 cannot have been seen by this camera" in reason_of(observed(moved))


def test_a_program_that_is_not_solved_is_a_failure_with_the_solvers_word(monkeypatch):
    monkeypatch.setattr(minimum_variation, "MOST_ITERATIONS", 1)
    assert "may contradict each other (solver: max iter reached)" in reason_of(observed(THREAD.at(SHARE)))


def spline_with(slack, P=THREAD.control_points):
    return MinimumVariationSpline(KNOTS, P, np.linspace(0, 1, len(slack)), slack)


def test_a_curve_is_the_thread_if_it_misses_a_tenth_at_most_and_is_finite_in_view_and_not_too_long():
    slack = np.concatenate((np.full(5, 1.5), np.full(15, 0.9), np.zeros(30)))
    assert contradiction(spline_with(slack)) == ""
    slack[5] = 1.1
    assert contradiction(spline_with(slack)).startswith("6 of 50 observations contradict")
    points = THREAD.at(np.array([0.2, 0.25]))
    long = length(KNOTS, THREAD.control_points, 3) / np.linalg.norm(points[1] - points[0])
    assert implausible(spline_with(slack), points).startswith(f"the curve is {long:.1f} times as long")
    assert implausible(spline_with(slack), THREAD.at(np.array([0.0, 1.0]))) == ""
    assert "not finite" in implausible(spline_with(slack, np.full((20, 3), np.nan)), points)
    assert "behind the camera" in implausible(spline_with(slack, THREAD.control_points - [0, 0, 100]), points)


@st.composite
def wanderings(draw):
    """Random walks over the image, with repeats, jumps in depth and turns; or straight lines."""
    count = draw(st.integers(2, 60))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    step = draw(st.sampled_from((0.0, 0.1, 2.0, 10.0, 200.0)))
    px = np.clip(np.cumsum(rng.normal(0, step, (count, 2)), axis=0) + np.array([480, 270]), 0, [960, 540])
    steps_px = rng.normal(0, draw(st.sampled_from((0.0, 0.3, 5.0))), count)
    disparity_px = np.maximum(60 + np.cumsum(steps_px), 1)
    jumps = rng.random(count) < draw(st.sampled_from((0.0, 0.1, 0.5)))
    disparity_px = np.where(jumps, rng.uniform(1, 120, count), disparity_px)
    if draw(st.booleans()):
        disparity_px = np.round(disparity_px)
    if draw(st.booleans()):
        px, disparity_px = np.linspace(px[0], px[-1], count), np.linspace(disparity_px[0], disparity_px[-1], count)
    order = np.sort(rng.integers(0, count, count)) if draw(st.booleans()) else rng.permutation(count)
    return backproject(CAMERA, px, CAMERA.fx_px * CAMERA.baseline / disparity_px)[order]


def anywhere():
    places = st.floats(-1e270, 1e270) | st.floats(-100, 100)
    depths = st.floats(1e-270, 1e270) | st.floats(1, 1000)
    return st.integers(0, 12).flatmap(
        lambda n: st.tuples(arrays(float, (n, 2), elements=places), arrays(float, n, elements=depths)).map(
            np.column_stack
        )
    )


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=40)
def test_any_observations_end_as_a_status(data):
    points = data.draw(wanderings() | anywhere())
    scale = data.draw(st.sampled_from((1.0, 1.0, 1e-3, 1e3, 1e-25, 1e25)))
    unit = data.draw(st.sampled_from((None, 1e-3, 1.0, 1e-300, 1e300)))
    half_size_px = data.draw(st.sampled_from((2.0, 7.5, 1e-300, 1e300)))
    last = max(len(points) - 2, 0)
    gaps = data.draw(st.lists(st.integers(0, last), max_size=min(3, last)))
    other = dataclasses.replace(CAMERA, baseline=CAMERA.baseline * scale, metres_per_unit=unit)
    sound(observed(points * scale, other, half_size_px, gaps=np.sort(np.array(gaps, np.int64))))
