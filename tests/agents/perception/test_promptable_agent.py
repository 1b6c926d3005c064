"""Perception with a promptable network: the thread at the click is found and followed in both eyes."""

import hashlib
import json

import numpy as np
import pytest

from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.segmentation.promptable_model import PromptableFileError
from schemas.messages import CommandAnswer, CommandHeader, Outcome, SetParameter, Status
from schemas.topics import CALIBRATION, SET, key
from shared.runtime.agent import Command, Received
from shared.runtime.parameters import Parameters
from tests.agents.perception.test_prompt import BLACK, DISPARITY, GREEN, asked, calibration, columns, seen
from tests.agents.perception.tiny_promptable import write_tiny


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("tiny"), hq=False, several=True)


@pytest.fixture
def agent(files):
    agent = Perception(PerceptionConfig("promptable", matching=True, promptable=files))
    assert list(agent.step(Received(CALIBRATION, key("lab", CALIBRATION), 0, calibration()))) == []
    return agent


@pytest.mark.slow
@pytest.mark.parametrize("thread", [BLACK, GREEN])
def test_the_thread_at_the_click_is_kept_alone_measured_and_followed_near_and_over_the_whole(agent, thread):
    seen(agent, 0)
    assert asked(agent, thread).outcome is Outcome.ACCEPTED
    for step, moved in ((1, 0), (2, 8), (100, 12)):
        found = seen(agent, step, moved)
        assert (found.status, found.segmenter) == (Status.OK, "promptable")
        assert np.abs(columns(found) - thread[0] - moved).max() < 6
        assert found.prompt_px is not None
    np.testing.assert_allclose(np.median(found.points_camera[:, 2]), 600 * 0.005 / DISPARITY, rtol=0.03)


@pytest.mark.slow
def test_a_click_where_nothing_is_found_is_taken_and_the_next_observations_say_so(agent):
    seen(agent, 0)
    assert asked(agent, (560, 300)).outcome is Outcome.ACCEPTED
    found = seen(agent, 1)
    assert found.status is Status.FAILED
    assert found.reason == "no thread was found in the left image by segmenter 'promptable'"
    assert asked(agent, (700, 300), 1).code == "outside"


def test_without_its_files_it_can_be_neither_configured_nor_set(files):
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


def test_a_file_of_another_hash_keeps_the_agent_from_being_made(files):
    other = hashlib.sha256(b"").hexdigest()
    with pytest.raises(PromptableFileError, match=f"should be {other}"):
        Perception(PerceptionConfig(promptable=type(files)(files.encoder, files.decoder, None, other)))
