"""What the perception agent does about what it judges: rows put in line, pictures that stand still, exposure."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.camera.scene_source import calibration_of
from agents.perception.agent import Perception
from agents.perception.judging.each_frame import ONE_STILL_FRAMES, STILL_FRAMES
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, ImageEncoding, Severity, Status, StereoFrame, ThreadObservations
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, key
from shared.images import decode_image, encode_image
from shared.runtime.agent import Received
from shared.scene.__main__ import make_scene
from shared.scene.render import render


@functools.cache
def scene():
    drawn = make_scene("easy", "tissue", 12)
    pair = render(drawn)
    return calibration_of(drawn.camera), pair.left_bgr, pair.right_bgr


def lower(image, rows):
    return np.roll(image, rows, axis=0)


def noisy(image, seed):
    return cv2.add(image, np.random.default_rng(seed).integers(0, 3, image.shape, np.uint8))


def frame(sequence, right_lower=0, left_noise=None, right_noise=None, change=lambda image: image):
    _, left, right = scene()
    noise = (left_noise if left_noise is not None else sequence, right_noise if right_noise is not None else sequence)
    images = noisy(change(left), noise[0]), noisy(change(lower(right, right_lower)), 1000 + noise[1])
    left, right = (encode_image(image, ImageEncoding.RAW) for image in images)
    return StereoFrame(FrameStamp(sequence, 1000 * sequence, 1000 * sequence, ""), left, right)


def given(agent, topic, message):
    """What an agent observes on a message, which travelled over the wire."""
    arrived = decode(topic.message, encode(message))
    outputs = list(agent.step(Received(topic, key("lab", topic), 0, arrived)))
    return [decode(ThreadObservations, encode(o.message)) for o in outputs if o.topic is OBSERVATIONS]


def fed(*frames):
    agent = Perception()
    given(agent, CALIBRATION, scene()[0])
    return [observed for one in frames for observed in given(agent, FRAMES, one)]


def codes(observed):
    return {j.code: j.severity for j in observed.judgements}


def rows_of(mask):
    return np.flatnonzero(decode_image(mask).max(axis=1) > 96)


@pytest.mark.slow
def test_a_baseline_in_the_wrong_unit_is_said_beside_the_thread():
    calibration, _, _ = scene()
    T = calibration.T_right_left.copy()
    T[:3, 3] *= 10.0
    agent = Perception()
    given(agent, CALIBRATION, replace(calibration, T_right_left=T))
    (observed,) = given(agent, FRAMES, frame(0))
    assert observed.status is Status.OK
    assert codes(observed) == {"distance_implausible": Severity.WARNING}
    assert "where no endoscope looks" in observed.judgements[0].finding


@pytest.mark.slow
def test_a_new_calibration_has_the_pair_judged_again():
    agent = Perception()
    for sequence, metres_per_unit in enumerate((1e-3, None)):
        given(agent, CALIBRATION, replace(scene()[0], metres_per_unit=metres_per_unit))
        (observed,) = given(agent, FRAMES, frame(sequence, 2))
        assert codes(observed) == {"row_offset": Severity.WARNING}
        assert "judged in frame" not in observed.judgements[0].finding


def test_rows_too_far_apart_to_be_a_little_off_are_a_fault_and_stay():
    (found,) = fed(frame(0, 12))
    assert (found.status, found.rows_moved_up) == (Status.FAILED, 0)
    assert codes(found) == {"row_residual": Severity.FAULT}


def test_a_replay_from_the_midst_goes_on_with_the_rows_as_they_were():
    frames = [frame(0, 3), frame(1, 3), frame(2, 3)]
    whole = fed(*frames)
    agent = Perception()
    given(agent, CALIBRATION, scene()[0])
    given(agent, OBSERVATIONS, whole[1])
    (later,) = given(agent, FRAMES, frames[2])
    assert encode(later) == encode(whole[2])


@pytest.mark.slow
def test_pictures_that_stand_still_are_said_to_while_they_do():
    still = {"left_noise": 5, "right_noise": 5}
    found = fed(frame(0), frame(5, **still), frame(5 + STILL_FRAMES, **still), frame(6 + STILL_FRAMES))
    assert [codes(o) for o in found] == [{}, {}, {"frozen": Severity.WARNING}, {}]
    assert "since frame 5" in found[2].judgements[0].finding
    _, begun_again = fed(frame(100, **still), frame(2, **still))
    assert begun_again.picture_left_since == 2


@pytest.mark.slow
def test_one_eye_that_stands_still_makes_frames_unusable_until_it_goes_on():
    last = 1 + ONE_STILL_FRAMES
    found = fed(*(frame(k, right_noise=1) for k in (1, 2, last)), frame(last + 1))
    assert [o.status for o in found] == [Status.OK, Status.OK, Status.FAILED, Status.OK]
    assert "the right eye has shown the very same picture since frame 1" in found[2].reason


@pytest.mark.slow
@pytest.mark.parametrize("rows", [-3, 2])
def test_rows_that_are_apart_are_put_in_line_and_said_to_be_until_the_camera_is_straight_again(rows):
    (straight,) = fed(frame(0))
    assert (straight.rows_moved_up, codes(straight)) == (0, {})
    straight_again = [frame(k) for k in range(61, 160, 3)]
    first, near, again, *_, come_back = fed(frame(0, rows), frame(1, rows), frame(40, rows), *straight_again)
    for observed in (first, near, again):
        assert observed.status is Status.OK
        assert observed.rows_moved_up == rows
        assert codes(observed) == {"row_offset": Severity.WARNING}
        assert abs(rows_of(observed.mask_right)[[0, -1]] - rows_of(straight.mask_right)[[0, -1]]).max() <= 1
    assert f"{abs(rows)}.0 px {'lower' if rows > 0 else 'higher'} than in the left" in first.judgements[0].finding
    assert near.judgements[0].finding.endswith("(judged in frame 0)")
    assert (come_back.rows_moved_up, codes(come_back)) == (0, {})


@pytest.mark.slow
def test_exposure_is_told_of_the_frame_at_hand_and_blur_until_the_whole_is_looked_at_again():
    def dark(image):
        return (image * 0.15).astype(np.uint8)

    def blurred(image):
        return cv2.GaussianBlur(image, (0, 0), 3.0)

    found = fed(frame(0), frame(1, change=dark), frame(2))
    assert ["too_dark" in codes(o) for o in found] == [False, True, False]
    found = fed(frame(0, change=blurred), frame(40))
    assert codes(found[0]).get("blurred") is Severity.WARNING
    assert "blurred" not in codes(found[1])
