"""Two threads in view: the one at the prompt is kept, followed and let go; a prompt beside both is refused."""

import functools
import hashlib
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.prompt import reach_px
from agents.perception.segmentation.promptable_model import PromptableFileError
from schemas.codec import decode, encode
from schemas.messages import (
    CommandAnswer,
    CommandHeader,
    ImageEncoding,
    Outcome,
    Prompt,
    SetParameter,
    Status,
    StereoCalibration,
)
from schemas.topics import PROMPT, SET
from shared.images import decode_image
from shared.runtime.agent import Command
from shared.runtime.parameters import Parameters
from tests.agents.perception.pictures import agent_with, fed, frame_of
from tests.agents.perception.tiny_promptable import write_tiny

WIDTH, HEIGHT, DISPARITY = 640, 360, 30
BLACK, GREEN = (150.0, 120.0), (360.0, 120.0)
"""Where the two threads cross row 120."""
DEPTH = 600 * 0.005 / DISPARITY


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


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("tiny"), hq=False, several=True)


@pytest.fixture
def agent_of(files):
    return lambda segmenter: agent_with(calibration(), segmenter, matching=True, promptable=files)


def seen(agent, sequence, moved=0):
    (found,) = fed(agent, frame_of((picture(0, moved), picture(DISPARITY, moved)), sequence, ImageEncoding.PNG))
    return found


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
@pytest.mark.parametrize("segmenter", ["threshold", "network", "promptable"])
@pytest.mark.parametrize("thread", [BLACK, GREEN])
def test_the_thread_at_the_prompt_is_kept_alone_measured_and_followed_until_it_is_cleared(agent_of, segmenter, thread):
    agent = agent_of(segmenter)
    seen(agent, 0)
    assert asked(agent, (thread[0] + 2, thread[1])).outcome is Outcome.ACCEPTED
    for sequence, moved in ((1, 0), (2, 8), (3, 16), (100, 20)):
        found = seen(agent, sequence, moved)
        assert (found.status, found.segmenter) == (Status.OK, segmenter)
        assert np.abs(columns(found) - thread[0] - moved).max() < 6
        assert found.prompt_px is not None
    assert found.looked_sequence == 100
    assert np.median(found.points_camera[:, 2]) == pytest.approx(DEPTH, rel=0.03)
    assert asked(agent, None, 1).outcome is Outcome.ACCEPTED
    found = seen(agent, 101, moved=20)
    assert found.prompt_px is None
    assert np.abs(columns(found) - BLACK[0] - 20).min() < 6


@pytest.mark.slow
def test_a_prompt_that_goes_on_from_recorded_observations_means_the_same_thread(agent_of):
    live, resumed = agent_of("network"), agent_of("network")
    seen(live, 0)
    asked(live, GREEN)
    assert fed(resumed, seen(live, 1, moved=5)) == []
    for sequence in (2, 40):
        assert encode(seen(resumed, sequence, moved=9)) == encode(seen(live, sequence, moved=9))


@pytest.mark.slow
def test_a_prompt_before_a_frame_outside_the_image_or_beside_every_thread_is_refused_and_changes_nothing(agent_of):
    agent = agent_of("network")
    assert asked(agent, BLACK).code == "no_frame"
    before = columns(seen(agent, 0))
    for pixel in ((-1, 5), (640, 5), (5, 360)):
        answer = asked(agent, pixel)
        assert (answer.outcome, answer.code) == (Outcome.REFUSED, "outside")
        assert "640x360" in answer.reason
    answer = asked(agent, (560, 300))
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "no_thread")
    assert f"within {reach_px(WIDTH):.0f} px of (560, 300) in the left image" in answer.reason
    found = seen(agent, 1)
    assert found.prompt_px is None
    np.testing.assert_array_equal(columns(found), before)


@pytest.mark.slow
def test_a_click_where_a_promptable_network_finds_nothing_is_taken_and_the_next_observations_say_so(agent_of):
    agent = agent_of("promptable")
    seen(agent, 0)
    assert asked(agent, (560, 300)).outcome is Outcome.ACCEPTED
    found = seen(agent, 1)
    assert found.status is Status.FAILED
    assert found.reason == "no thread was found in the left image by segmenter 'promptable'"


def test_a_promptable_network_can_be_neither_configured_nor_set_without_its_files_nor_with_others(files):
    with pytest.raises(ValueError, match="it needs promptable_encoder and promptable_decoder"):
        PerceptionConfig("promptable")
    set_promptable = SetParameter(CommandHeader("one", 10**18, "test"), "segmenter", json.dumps("promptable"))
    for config, outcome in (
        (PerceptionConfig(), Outcome.REFUSED),
        (PerceptionConfig(promptable=files), Outcome.ACCEPTED),
    ):
        (answer,) = Parameters(Perception(config)).step(Command(SET, "main", set_promptable, 0))
        assert isinstance(answer, CommandAnswer)
        assert answer.outcome is outcome, answer
    other = hashlib.sha256(b"").hexdigest()
    with pytest.raises(PromptableFileError, match=f"should be {other}"):
        Perception(PerceptionConfig(promptable=replace(files, decoder_sha256=other)))
