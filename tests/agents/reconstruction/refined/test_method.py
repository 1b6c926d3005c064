"""Method refined from observations to the message, and every way in which it fails."""

import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.reconstruction.methods import METHODS
from agents.reconstruction.refined.method import METHOD, reconstruct_refined
from schemas.codec import encode
from schemas.messages import GIVEN_MASKS, ImageEncoding, Occluder, Occluders, Status, ThreadCandidate, no_centrelines
from shared.arc_length import even_parameters
from shared.calibration.uncertainty import ERRORS, displacements
from shared.camera import project
from shared.curve_distance import curve_distance
from shared.images import encode_image
from shared.splines import evaluate

DENSE = np.linspace(0, 1, 4001)


@pytest.fixture
def seen(observe, see, camera):
    def of(curve, shown=((0.0, 1.0),), **changes):
        left, right = (see(curve, eye, shown) for eye in (0, 1))
        return observe(np.zeros((0, 3)), camera, **({"centrelines_left": left, "centrelines_right": right} | changes))

    return of


def points_of(thread, count=1000):
    knots, P = thread.knots, thread.control_points_camera
    return evaluate(knots, P, 3, even_parameters(knots, P, 3, count))


def reason_of(observations):
    thread = reconstruct_refined(observations)
    assert thread.status is Status.FAILED
    assert (thread.method, thread.stamp) == (METHOD, observations.stamp)
    return thread.reason


def test_the_default_method_finds_the_thread_from_both_centrelines_each_time(seen, curve):
    assert METHODS[DEFAULT_METHOD] is reconstruct_refined
    thread = reconstruct_refined(seen(curve))
    assert encode(reconstruct_refined(seen(curve))) == encode(thread)
    assert (thread.status, thread.reason, thread.method) == (Status.OK, "", "refined")
    error = curve_distance(points_of(thread), curve(DENSE))
    assert error.mean < 0.05
    assert error.frechet < 0.5
    assert len(thread.posterior_s) == len(thread.posterior_covariance) == len(thread.confidence) >= 100
    assert thread.confidence.min() > 0.9
    assert thread.unseen.shape == (0, 2)


def test_its_first_end_is_the_left_one(seen, curve, camera, see, make_lines):
    both = [reconstruct_refined(seen(curve))]
    turned = [make_lines(see(curve, eye).point_px[::-1]) for eye in (0, 1)]
    both.append(reconstruct_refined(seen(curve, centrelines_left=turned[0], centrelines_right=turned[1])))
    for thread in both:
        ends, _ = project(camera, thread.control_points_camera[[0, -1]])
        assert ends[0, 0] <= ends[1, 0]
    assert curve_distance(points_of(both[0]), points_of(both[1])).maximum < 0.1


def test_what_neither_image_shows_is_told_and_less_certain(seen, threads):
    thread = reconstruct_refined(seen(threads["winding"], ((0.0, 0.4), (0.6, 1.0))))
    assert thread.status is Status.OK
    ((low, high),) = thread.unseen
    assert 0.3 < low < 0.5
    assert 0.5 < high < 0.7
    deviation = np.sqrt(np.trace(thread.posterior_covariance, axis1=1, axis2=2))
    hidden = (thread.posterior_s > low) & (thread.posterior_s < high)
    beside = (np.abs(thread.posterior_s - low) < 0.2) & ~hidden
    assert deviation[hidden].max() > deviation[beside].min()
    assert curve_distance(points_of(thread), threads["winding"](DENSE)).maximum < 2.0


def test_an_eye_that_is_turned_unseen_is_within_what_is_told_of_the_calibration(seen, curve, camera, see, make_lines):
    turned = 1e-3
    of_calibration = np.zeros((8, 8))
    of_calibration[ERRORS.index("vergence"), ERRORS.index("vergence")] = turned**2
    right = see(curve, 1).point_px
    off_px = turned * camera.fx_px * (1 + ((right[:, 0] - camera.cx_px) / camera.fx_px) ** 2)
    wrong = make_lines(right + np.column_stack((off_px, np.zeros(len(off_px)))))
    alone, told = (
        reconstruct_refined(seen(curve, centrelines_right=wrong, calibration_covariance=covariance))
        for covariance in (0 * of_calibration, of_calibration)
    )
    at = evaluate(told.knots, told.control_points_camera, 3, told.posterior_s)
    off = np.abs(at[:, 2] - curve(DENSE)[KDTree(curve(DENSE)[:, :2]).query(at[:, :2])[1], 2])
    assert np.median(off) > 1.0
    moved = displacements(camera, at)
    whole = told.posterior_covariance + moved @ told.calibration_covariance @ moved.transpose(0, 2, 1)
    # one deviation of the calibration, as the camera frame has it
    assert 0.8 < np.median(off / np.sqrt(whole[:, 2, 2])) < 1.2
    # of which a hand-eye transform takes most back; what bends is in the posterior
    bent = told.posterior_covariance - alone.posterior_covariance
    assert 0.01 < np.sqrt(bent[:, 2, 2].max()) < 0.5 * np.median(off)


def over(curve, camera, *stretches):
    """Instruments over stretches of a curve in both images."""
    maps = [np.zeros((135, 240), np.uint8) for _ in range(2)]
    for low, high in stretches:
        for drawn, px in zip(maps, project(camera, curve(np.linspace(low, high, 40))), strict=True):
            cv2.polylines(drawn, [np.rint((px + 0.5) / 4 - 0.5).astype(np.int32)], False, Occluder.TOOL.value, 5)
    left, right = (encode_image(drawn, ImageEncoding.PNG) for drawn in maps)
    return Occluders(left, right, 7)


@pytest.mark.parametrize("turned", [False, True])
def test_what_lies_under_an_instrument_is_hidden_and_an_end_beside_one_has_ended(seen, threads, camera, turned):
    """From whichever end the thread is shown, it is told from the left one."""

    def curve(t):
        return threads["waving"](1 - t if turned else t)

    def along(*stretches):
        return [(1 - b, 1 - a) if turned else (a, b) for a, b in stretches]

    shown = along((0.0, 0.3), (0.45, 0.9))
    told: dict[str, Any] = {
        name: reconstruct_refined(seen(curve, shown, occluders=occluders))
        for name, occluders in {
            "both": over(curve, camera, *along((0.29, 0.46), (0.9, 1.0))),
            "middle": over(curve, camera, *along((0.29, 0.46))),
            "none": over(curve, camera),
            "unknown": None,
        }.items()
    }
    assert {name: None if t.ends_hidden is None else t.ends_hidden.tolist() for name, t in told.items()} == {
        "both": [False, True],
        "middle": [False, False],
        "none": [False, False],
        "unknown": None,
    }
    for name in ("both", "middle"):
        (hidden,), (unseen,) = told[name].hidden, told[name].unseen
        np.testing.assert_allclose(hidden, unseen, atol=0.02)
        assert 0.25 < hidden[0] < hidden[1] < 0.55
    assert len(told["none"].hidden) == 0
    assert len(told["none"].unseen) == 1
    assert told["unknown"].hidden is None


def test_the_unit_changes_nothing_but_the_unit(seen, threads, camera):
    curve = threads["winding"]
    thread = reconstruct_refined(seen(curve))
    in_metres = dataclasses.replace(camera, baseline=camera.baseline * 1e-3, metres_per_unit=1.0)
    other = reconstruct_refined(dataclasses.replace(seen(curve), camera=in_metres))
    np.testing.assert_allclose(other.control_points_camera, 1e-3 * thread.control_points_camera, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(other.confidence, thread.confidence, atol=1e-4)


def test_observations_that_are_no_thread_are_refused_with_the_reason(observe, seen, threads, see, make_lines):
    curve = threads["winding"]
    dark = observe(np.zeros((0, 3)), status=Status.FAILED, reason="no thread was found in the left image")
    assert reason_of(dark) == "no thread was found in the left image"
    for eye in ("left", "right"):
        told = reason_of(seen(curve, **{f"centrelines_{eye}": no_centrelines()}))
        assert told.startswith(f"the {eye} image shows too little thread: 0 px")
    speck = make_lines(np.array([[400.0, 200.0], [408.0, 203.0]]))
    assert "too little thread" in reason_of(seen(curve, centrelines_left=speck))
    dots = make_lines(*(np.array([[u, 200.0], [u + 2.0, 201.0]]) for u in range(100, 700, 40)))
    assert "no piece of thread" in reason_of(seen(curve, centrelines_left=dots))
    exchanged = seen(curve, centrelines_left=see(curve, 1), centrelines_right=see(curve, 0))
    assert "left and right are not exchanged" in reason_of(exchanged)
    other = make_lines(np.array([[100.0, 40.0], [140.0, 90.0]]))
    assert "check that both images show the same thread" in reason_of(seen(curve, centrelines_right=other))


@pytest.mark.parametrize(
    ("shift", "told"), [((-420.0, 0.0), "counterpart"), ((0.0, 320.0), "counterpart"), ((119.9, 0.0), "check that")]
)
def test_a_calibration_that_is_not_the_images_own_is_suspected(seen, threads, see, make_lines, shift, told):
    right = np.clip(see(threads["winding"], 1).point_px + np.array(shift), [-400, 0], [960, 800])
    reason = reason_of(seen(threads["winding"], centrelines_right=make_lines(right)))
    assert told in reason or "contradict" in reason


def test_numbers_that_no_camera_has_are_a_reason(seen, threads, camera, make_lines):
    curve = threads["winding"]
    assert "check its unit" in reason_of(
        dataclasses.replace(seen(curve), camera=dataclasses.replace(camera, baseline=1e200))
    )
    outside = make_lines(np.array([[4000.0, 100.0], [4100.0, 200.0]]))
    assert "outside" in reason_of(seen(curve, centrelines_left=outside))


def test_what_hardly_looks_like_thread_is_none_unless_somebody_says_that_it_is(seen, threads):
    observations = dataclasses.replace(seen(threads["winding"]), segmenter="network")
    line = observations.centrelines_left.point_px[::8]
    weak = ThreadCandidate(0.2, line, observations.centrelines_right.point_px[::8], 6.0, np.array([20, 20, 60]))
    doubtful = dataclasses.replace(observations, candidates=(weak,))
    assert "score 0.20 of at least" in reason_of(doubtful)
    assert reconstruct_refined(dataclasses.replace(doubtful, prompt_px=line[0])).status is Status.OK
    assert reconstruct_refined(dataclasses.replace(doubtful, segmenter=GIVEN_MASKS)).status is Status.OK
    sure = dataclasses.replace(weak, score=0.6)
    assert reconstruct_refined(dataclasses.replace(observations, candidates=(sure,))).status is Status.OK
