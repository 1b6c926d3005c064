"""Method refined from observations to the message, and every way in which it fails; and the agent that runs methods."""

import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from agents.reconstruction.agent import Reconstruction
from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.reconstruction.methods import METHODS
from agents.reconstruction.refined.method import reconstruct_refined
from schemas.codec import encode
from schemas.messages import GIVEN_MASKS, ImageEncoding, Occluder, Occluders, Status, ThreadCandidate, no_centrelines
from schemas.topics import OBSERVATIONS, THREAD, key
from shared.arc_length import even_parameters
from shared.calibration.uncertainty import ERRORS, displacements
from shared.camera import project
from shared.curve_distance import curve_distance
from shared.images import encode_image
from shared.runtime.agent import Received, Tick
from shared.splines import evaluate
from tests.agents.reconstruction.threads import (
    CAMERA,
    lines_of,
    observed,
    observed_curve,
    observed_lines,
    see,
    waving,
    winding,
)

DENSE = np.linspace(0, 1, 4001)
LEFT, RIGHT = see(winding, 0), see(winding, 1)
both_curves = pytest.mark.parametrize("curve", [winding, waving])


def points_of(thread):
    knots, P = thread.knots, thread.control_points_camera
    return evaluate(knots, P, 3, even_parameters(knots, P, 3, 1000))


@both_curves
def test_the_default_method_finds_the_thread_from_both_centrelines_each_time_its_left_end_first(curve):
    thread = reconstruct_refined(observed_curve(curve))
    assert encode(METHODS[DEFAULT_METHOD](observed_curve(curve))) == encode(thread)
    assert (thread.status, thread.reason, thread.method) == (Status.OK, "", "refined")
    error = curve_distance(points_of(thread), curve(DENSE))
    assert error.mean < 0.05
    assert error.frechet < 0.5
    assert len(thread.posterior_s) == len(thread.posterior_covariance) == len(thread.confidence) >= 100
    assert thread.confidence.min() > 0.9
    assert thread.unseen.shape == (0, 2)
    left, right = (lines_of(see(curve, eye).point_px[::-1]) for eye in (0, 1))
    turned = reconstruct_refined(observed_lines(left, right))
    for told in (thread, turned):
        ends, _ = project(CAMERA, told.control_points_camera[[0, -1]])
        assert ends[0, 0] <= ends[1, 0]
    assert curve_distance(points_of(turned), points_of(thread)).maximum < 0.1


def test_what_neither_image_shows_is_told_and_less_certain():
    thread = reconstruct_refined(observed_curve(winding, ((0.0, 0.4), (0.6, 1.0))))
    ((low, high),) = thread.unseen
    assert 0.3 < low < 0.5 < high < 0.7
    deviation = np.sqrt(np.trace(thread.posterior_covariance, axis1=1, axis2=2))
    hidden = (thread.posterior_s > low) & (thread.posterior_s < high)
    beside = (np.abs(thread.posterior_s - low) < 0.2) & ~hidden
    assert deviation[hidden].max() > deviation[beside].min()
    assert curve_distance(points_of(thread), winding(DENSE)).maximum < 2.0


@both_curves
def test_an_eye_that_is_turned_unseen_is_within_what_is_told_of_the_calibration(curve):
    turned, vergence = 1e-3, ERRORS.index("vergence")
    of_calibration = np.zeros((8, 8))
    of_calibration[vergence, vergence] = turned**2
    right = see(curve, 1).point_px
    off_px = turned * CAMERA.fx_px * (1 + ((right[:, 0] - CAMERA.cx_px) / CAMERA.fx_px) ** 2)
    wrong = lines_of(right + np.column_stack((off_px, np.zeros(len(off_px)))))
    alone, told = (
        reconstruct_refined(observed_lines(see(curve, 0), wrong, calibration_covariance=covariance))
        for covariance in (0 * of_calibration, of_calibration)
    )
    at = evaluate(told.knots, told.control_points_camera, 3, told.posterior_s)
    off = np.abs(at[:, 2] - curve(DENSE)[KDTree(curve(DENSE)[:, :2]).query(at[:, :2])[1], 2])
    assert np.median(off) > 1.0
    moved = displacements(CAMERA, at)
    whole = told.posterior_covariance + moved @ told.calibration_covariance @ moved.transpose(0, 2, 1)
    # one deviation of the calibration, as the camera frame has it
    assert 0.8 < np.median(off / np.sqrt(whole[:, 2, 2])) < 1.2
    # of which a hand-eye transform takes most back; what bends is in the posterior
    bent = told.posterior_covariance - alone.posterior_covariance
    assert 0.01 < np.sqrt(bent[:, 2, 2].max()) < 0.5 * np.median(off)


def over(curve, *stretches):
    """Instruments over stretches of a curve in both images."""
    maps = [np.zeros((135, 240), np.uint8) for _ in range(2)]
    for low, high in stretches:
        for drawn, px in zip(maps, project(CAMERA, curve(np.linspace(low, high, 40))), strict=True):
            cv2.polylines(drawn, [np.rint((px + 0.5) / 4 - 0.5).astype(np.int32)], False, Occluder.TOOL.value, 5)
    left, right = (encode_image(drawn, ImageEncoding.PNG) for drawn in maps)
    return Occluders(left, right, 7)


@pytest.mark.parametrize("turned", [False, True])
def test_what_lies_under_an_instrument_is_hidden_and_an_end_beside_one_has_ended(turned):
    """From whichever end the thread is shown, it is told from the left one."""

    def curve(t):
        return waving(1 - t if turned else t)

    def along(*stretches):
        return [(1 - b, 1 - a) if turned else (a, b) for a, b in stretches]

    middle, end = along((0.29, 0.46), (0.9, 1.0))
    for occluders, ends, hides in (
        (over(curve, middle, end), [False, True], True),
        (over(curve, middle), [False, False], True),
        (over(curve), [False, False], False),
    ):
        told: Any = reconstruct_refined(observed_curve(curve, along((0.0, 0.3), (0.45, 0.9)), occluders=occluders))
        assert told.ends_hidden.tolist() == ends
        assert (len(told.hidden), len(told.unseen)) == (int(hides), 1)
        if hides:
            np.testing.assert_allclose(told.hidden, told.unseen, atol=0.02)
            assert 0.25 < told.hidden[0, 0] < told.hidden[0, 1] < 0.55


def test_the_unit_changes_nothing_but_the_unit():
    in_metres = dataclasses.replace(CAMERA, baseline=CAMERA.baseline * 1e-3, metres_per_unit=1.0)
    thread, other = (reconstruct_refined(observed_lines(LEFT, RIGHT, camera)) for camera in (CAMERA, in_metres))
    np.testing.assert_allclose(other.control_points_camera, 1e-3 * thread.control_points_camera, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(other.confidence, thread.confidence, atol=1e-4)


def reason_of(left=LEFT, right=RIGHT, **changes):
    thread = reconstruct_refined(observed_lines(left, right, **changes))
    assert (thread.status, thread.method) == (Status.FAILED, "refined")
    return thread.reason


def test_observations_that_are_no_thread_are_refused_with_the_reason():
    assert reason_of(status=Status.FAILED, reason="it is dark in here") == "it is dark in here"
    assert reason_of(left=no_centrelines()).startswith("the left image shows too little thread: 0 px")
    assert reason_of(right=no_centrelines()).startswith("the right image shows too little thread: 0 px")
    speck = lines_of(np.array([[400.0, 200.0], [408.0, 203.0]]))
    assert "too little thread" in reason_of(speck)
    dots = lines_of(*(np.array([[u, 200.0], [u + 2.0, 201.0]]) for u in range(100, 700, 40)))
    assert "no piece of thread" in reason_of(dots)
    assert "left and right are not exchanged" in reason_of(RIGHT, LEFT)
    other = lines_of(np.array([[100.0, 40.0], [140.0, 90.0]]))
    assert "check that both images show the same thread" in reason_of(right=other)
    # a calibration that is not the images' own
    for shift in ((-420.0, 0.0), (0.0, 320.0), (119.9, 0.0)):
        reason = reason_of(right=lines_of(np.clip(RIGHT.point_px + np.array(shift), [-400, 0], [960, 800])))
        assert any(told in reason for told in ("counterpart", "check that", "contradict")), reason
    assert "check its unit" in reason_of(camera=dataclasses.replace(CAMERA, baseline=1e200))
    assert "outside" in reason_of(lines_of(np.array([[4000.0, 100.0], [4100.0, 200.0]])))


def test_what_hardly_looks_like_thread_is_none_unless_somebody_says_that_it_is():
    line = LEFT.point_px[::8]
    weak = ThreadCandidate(0.2, line, RIGHT.point_px[::8], 6.0, np.array([20, 20, 60]))
    assert "score 0.20 of at least" in reason_of(segmenter="network", candidates=(weak,))
    some: tuple[dict[str, Any], ...] = (
        {"prompt_px": line[0], "candidates": (weak,)},
        {"segmenter": GIVEN_MASKS, "candidates": (weak,)},
        {"candidates": (dataclasses.replace(weak, score=0.6),)},
    )
    for told in some:
        changes: dict[str, Any] = {"segmenter": "network", **told}
        assert reconstruct_refined(observed_lines(LEFT, RIGHT, **changes)).status is Status.OK


def fed(agent, message):
    (output,) = agent.step(Received(OBSERVATIONS, key("lab", OBSERVATIONS), 0, message))
    assert output.topic is THREAD
    return output.message


@pytest.mark.parametrize("method", METHODS)
def test_the_agent_makes_a_thread_of_the_same_frame_of_each_message_or_fails_with_its_reason(method):
    observations = observed(winding(np.linspace(0, 1, 12)), centrelines_left=LEFT, centrelines_right=RIGHT)
    dark = observed(status=Status.FAILED, reason="no thread was found in the left image")
    moved = dataclasses.replace(observations, points_camera=observations.points_camera + 1.0)
    agent, alone = Reconstruction(method, tracking=False), encode(METHODS[method](observations))
    thread = fed(agent, observations)
    assert (thread.status, thread.stamp, thread.method) == (Status.OK, observations.stamp, method)
    assert len(thread.regions.s) >= 8
    assert "no thread was found in the left image" in fed(agent, dark).reason
    # nothing is kept from one message to the next
    fed(agent, moved)
    assert encode(fed(agent, observations)) == alone
    assert list(agent.step(Tick(1))) == []


def test_the_agent_tracks_with_a_method_that_can_and_does_not_know_any_other():
    assert Reconstruction("paper").goes_on_from is None
    assert Reconstruction().goes_on_from is THREAD
    with pytest.raises(KeyError):
        Reconstruction("magic")
