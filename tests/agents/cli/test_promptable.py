"""Segmenter `promptable` as a user asks for it: in a rig's file, in `reconstruct`, and by clicks into a running rig."""

import hashlib
import json

import numpy as np
import pytest

from agents.camera.agent import Camera, CameraConfig
from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.perception.agent import Perception, PerceptionConfig
from schemas.codec import decode
from schemas.messages import ImageEncoding, Status, ThreadObservations
from schemas.topics import OBSERVATIONS
from shared.runtime.config import ConfigError, parse_config
from shared.runtime.connection import connected
from tests.agents.cli.conftest import of_pair, refused
from tests.agents.perception.test_prompt import BLACK, DISPARITY, GREEN, calibration, columns, picture
from tests.agents.perception.tiny_promptable import write_tiny


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("tiny"), hq=True)


def rig(**perception):
    return parse_config(json.dumps({"perception": perception}), RigConfig, "rig.json")


def test_a_rig_names_the_files_and_their_hashes_or_is_told_what_it_lacks(files):
    sha256 = hashlib.sha256(files.encoder.read_bytes()).hexdigest()
    named = {"promptable_encoder": str(files.encoder), "promptable_decoder": str(files.decoder)}
    agent = build(rig(segmenter="promptable", promptable_encoder_sha256=sha256, **named), "perception", "main")
    assert isinstance(agent, Perception)
    assert agent.config.segmenter == "promptable"
    assert agent.config.promptable is not None
    assert (agent.config.promptable.encoder_sha256, agent.config.promptable.decoder_sha256) == (sha256, None)
    for perception, told in (
        ({"segmenter": "promptable"}, "segmenter 'promptable' needs promptable_encoder and promptable_decod"),
        ({"promptable_encoder": "a.onnx"}, "needs promptable_encoder and promptable_decoder, two ONNX files"),
        ({"promptable_encoder_sha256": "abc"}, "'abc' cannot be used; write 64 digits 0 to 9 and a to f"),
    ):
        with pytest.raises(ConfigError) as caught:
            rig(**perception)
        assert told in str(caught.value)


def test_files_that_cannot_be_used_are_named_in_one_sentence(suturegrasp, files, small, tmp_path):
    config, out = tmp_path / "rig.toml", ("--output", tmp_path / "thread.json", "--segmenter", "promptable")
    named = f"promptable_encoder = '{tmp_path / 'none.onnx'}'\npromptable_decoder = '{files.decoder}'\n"
    config.write_text(f"[perception]\n{named}")
    told = f"promptable_encoder {tmp_path / 'none.onnx'} cannot be read: No such file or directory"
    refused(suturegrasp("run", "perception", "--config", config), told)
    network = ("--promptable-encoder", tmp_path / "none.onnx", "--promptable-decoder", files.decoder)
    refused(suturegrasp(*of_pair(small), *out, *network), told)


class Still:
    """A camera above two threads that lie still."""

    taken_ns = 0, 0

    def read(self):
        return picture(0, 0), picture(DISPARITY, 0)

    def close(self):
        pass


@pytest.mark.slow
def test_a_click_tells_a_running_rig_which_thread_is_meant_until_it_is_taken_back(
    suturegrasp, settings, in_threads, rig_file, until, files
):
    perception = Perception(PerceptionConfig("promptable", promptable=files))
    camera = Camera(Still(), calibration(), CameraConfig(rate_hz=2.0, encoding=ImageEncoding.PNG))
    config, seen = rig_file(), []

    def observed(condition=lambda _: True):
        """What is observed from now on, and meets a condition."""
        seen.clear()
        return until(lambda: next(filter(condition, tuple(seen)), None))

    with connected(settings, 60.0) as connection, in_threads(settings, perception, camera):
        connection.listen((OBSERVATIONS,), lambda tapped: seen.append(decode(ThreadObservations, tapped.payload)))
        observed()
        for u, v in (GREEN, BLACK):
            ended = suturegrasp("prompt", "--pixel", f"{u:.0f}", f"{v:.0f}", "--config", config)
            assert (ended.status, ended.err, ended.out.strip()) == (
                0,
                "",
                "this thread is meant from the next frame on",
            )
            found = observed(lambda one, u=u: one.prompt_px is not None and abs(one.prompt_px[0] - u) < 30)
            assert (found.status, found.segmenter) == (Status.OK, "promptable")
            assert np.abs(columns(found) - u).max() < 6
        ended = suturegrasp("prompt", "--pixel", 700, 10, "--config", config)
        refused(ended, "(700, 10) lies outside the left image of 640x360 pixels", status=3)
        ended = suturegrasp("prompt", "--config", config)
        assert (ended.status, ended.out.strip()) == (0, "perception chooses the thread")
        assert observed(lambda one: one.prompt_px is None).segmenter == "promptable"
