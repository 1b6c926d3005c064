"""Two threads in view: the one at the prompt is kept, followed and let go; a prompt beside both is refused."""

import functools

import cv2
import numpy as np
import pytest

from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.prompt import reach_px
from schemas.codec import decode, encode
from schemas.messages import (
    CommandAnswer,
    CommandHeader,
    FrameStamp,
    ImageEncoding,
    Outcome,
    Prompt,
    Status,
    StereoCalibration,
    StereoFrame,
)
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, PROMPT, key
from shared.images import decode_image, encode_image
from shared.runtime.agent import Command, Received

WIDTH, HEIGHT, DISPARITY = 640, 360, 30
BLACK, GREEN = (150.0, 120.0), (360.0, 120.0)
"""Where the two threads cross row 120."""
SEGMENTERS = pytest.mark.parametrize("segmenter", ["threshold", "network"])


def calibration():
    K = np.array([[600.0, 0, 319.5], [0, 600.0, 179.5], [0, 0, 1]])
    T = np.eye(4)
    T[0, 3] = -0.005
    return StereoCalibration(WIDTH, HEIGHT, K, K.copy(), np.zeros(0), np.zeros(0), T, 1.0)


@functools.cache
def picture(shift, moved):
    """A long black thread, and a shorter green one that stands out less, each with its sheen and its shadow."""
    grain = cv2.GaussianBlur(np.random.default_rng(1).normal(0, 12, (HEIGHT, WIDTH)), (0, 0), 1.5)
    image = np.clip(np.array((150, 165, 205)) + grain[..., None], 0, 255).astype(np.uint8)
    for (u, v), rows, colour in ((BLACK, (40, 320), (20, 20, 20)), (GREEN, (60, 220), (60, 120, 60))):
        at = np.arange(*rows)
        points = np.column_stack((u + 25 * np.sin((at - v) / 40) - shift + moved, at))
        line = [np.round(points * 16).astype(np.int32)]
        shadow = np.zeros((HEIGHT, WIDTH), np.uint8)
        cv2.polylines(shadow, [line[0] + 32], False, 255, 3, cv2.LINE_AA, 4)
        image = (image * (1 - 0.4 * cv2.GaussianBlur(shadow, (0, 0), 1.5)[..., None] / 255)).astype(np.uint8)
        cv2.polylines(image, line, False, colour, 3, cv2.LINE_AA, 4)
        cv2.polylines(image, [line[0] - 8], False, tuple(c + 70 for c in colour), 1, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(image, (0, 0), 0.7)


def frame(sequence, moved=0):
    left, right = (encode_image(picture(shift, moved), ImageEncoding.PNG) for shift in (0, DISPARITY))
    return Received(FRAMES, key("lab", FRAMES), sequence, StereoFrame(FrameStamp(sequence, 1, 2, ""), left, right))


def agent_of(segmenter):
    agent = Perception(PerceptionConfig(segmenter, matching=True))
    assert list(agent.step(Received(CALIBRATION, key("lab", CALIBRATION), 0, calibration()))) == []
    return agent


def seen(agent, sequence, moved=0):
    """The observations of a frame, over the wire."""
    (found,) = (o.message for o in agent.step(frame(sequence, moved)) if o.topic is OBSERVATIONS)
    return decode(OBSERVATIONS.message, encode(found))


def asked(agent, pixel, number=0):
    header = CommandHeader(f"prompt {number}", 10**18, "test")
    prompt = Prompt(header, None if pixel is None else np.array(pixel, float))
    (answer,) = agent.step(Command(PROMPT, "main", decode(Prompt, encode(prompt)), 0))
    assert isinstance(answer, CommandAnswer)
    assert answer.id == header.id
    return answer


def columns(observations, row=120):
    """Where the mask of the left image crosses a row."""
    return np.flatnonzero(decode_image(observations.mask_left)[row])


@pytest.mark.slow
@SEGMENTERS
@pytest.mark.parametrize("thread", [BLACK, GREEN])
def test_the_thread_at_the_prompt_is_kept_alone_and_measured(segmenter, thread):
    agent = agent_of(segmenter)
    seen(agent, 0)
    assert asked(agent, (thread[0] + 6, thread[1])).outcome is Outcome.ACCEPTED
    found = seen(agent, 1)
    assert found.status is Status.OK
    assert np.abs(columns(found) - thread[0]).max() < 6
    np.testing.assert_allclose(np.median(found.points_camera[:, 2]), 600 * 0.005 / DISPARITY, rtol=0.03)


@pytest.mark.slow
@SEGMENTERS
def test_it_is_followed_as_it_moves_near_and_over_the_whole_until_it_is_cleared(segmenter):
    agent = agent_of(segmenter)
    seen(agent, 0)
    asked(agent, GREEN)
    for step in (1, 2, 3):
        found = seen(agent, step, moved=10 * step)
        assert np.abs(columns(found) - GREEN[0] - 10 * step).max() < 6
        assert found.prompt_px is not None
    found = seen(agent, 100, moved=35)
    assert found.looked_sequence == 100
    assert np.abs(columns(found) - GREEN[0] - 35).max() < 6
    assert asked(agent, None, 1).outcome is Outcome.ACCEPTED
    found = seen(agent, 101, moved=35)
    assert found.prompt_px is None
    assert np.abs(columns(found) - BLACK[0] - 35).min() < 6


@pytest.mark.slow
def test_a_prompt_that_goes_on_from_recorded_observations_means_the_same_thread():
    live, resumed = agent_of("network"), agent_of("network")
    seen(live, 0)
    asked(live, GREEN)
    before = seen(live, 1, moved=5)
    assert list(resumed.step(Received(OBSERVATIONS, key("lab", OBSERVATIONS), 0, before))) == []
    for sequence in (2, 40):
        assert encode(seen(resumed, sequence, moved=9)) == encode(seen(live, sequence, moved=9))


@pytest.mark.slow
def test_a_prompt_beside_every_thread_is_refused_in_one_sentence_and_changes_nothing():
    agent = agent_of("network")
    before = columns(seen(agent, 0))
    answer = asked(agent, (560, 300))
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "no_thread")
    assert answer.reason == f"nothing like thread lies within {reach_px(WIDTH):.0f} px of (560, 300) in the left image"
    found = seen(agent, 1)
    assert found.prompt_px is None
    np.testing.assert_array_equal(columns(found), before)


def test_a_prompt_outside_the_image_or_before_a_frame_is_refused():
    agent = agent_of("network")
    assert asked(agent, BLACK).code == "no_frame"
    seen(agent, 0)
    for pixel in ((-1, 5), (640, 5), (5, 360)):
        answer = asked(agent, pixel)
        assert (answer.outcome, answer.code) == (Outcome.REFUSED, "outside")
        assert "640x360" in answer.reason
