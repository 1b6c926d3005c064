"""Segmenter `promptable` as a user asks for it: in a rig's configuration, on the command line, and what is wrong."""

import hashlib
import json

import cv2
import numpy as np
import pytest

from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.perception.agent import Perception
from shared.runtime.config import ConfigError, parse_config
from tests.agents.perception.tiny_promptable import write_tiny


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("tiny"), hq=True)


def rig(**perception):
    return parse_config(json.dumps({"perception": perception}), RigConfig, "rig.json")


def of(files, **others):
    return {"promptable_encoder": str(files.encoder), "promptable_decoder": str(files.decoder)} | others


def test_a_rig_names_the_files_and_their_hashes(files):
    sha256 = hashlib.sha256(files.encoder.read_bytes()).hexdigest()
    agent = build(rig(segmenter="promptable", **of(files, promptable_encoder_sha256=sha256)), "perception", "main")
    assert isinstance(agent, Perception)
    assert agent.config.segmenter == "promptable"
    assert agent.config.promptable is not None
    assert (agent.config.promptable.encoder_sha256, agent.config.promptable.decoder_sha256) == (sha256, None)


def test_what_a_configuration_lacks_is_said_when_it_is_read():
    for perception, told in (
        ({"segmenter": "promptable"}, "segmenter 'promptable' needs promptable_encoder and promptable_decod"),
        ({"promptable_encoder": "a.onnx"}, "needs promptable_encoder and promptable_decoder, two ONNX files"),
        ({"promptable_encoder_sha256": "abc"}, "'abc' cannot be used; write 64 digits 0 to 9 and a to f"),
    ):
        with pytest.raises(ConfigError) as caught:
            rig(**perception)
        assert told in str(caught.value)


def test_files_that_cannot_be_used_keep_the_agent_from_starting_in_one_sentence(suturegrasp, files, tmp_path):
    missing, config = tmp_path / "none.onnx", tmp_path / "rig.toml"
    config.write_text(f"[perception]\npromptable_encoder = '{missing}'\npromptable_decoder = '{files.decoder}'\n")
    ended = suturegrasp("run", "perception", "--config", config)
    assert (ended.status, len(ended.err.splitlines())) == (2, 1)
    assert f"promptable_encoder {missing} cannot be read: No such file or directory" in ended.err


@pytest.mark.slow
def test_reconstruct_takes_the_thread_at_a_pixel_from_the_network(suturegrasp, files, small, pair, tmp_path):
    out = tmp_path / "thread.json"
    left = cv2.imread(str(small / "left.png"))
    assert left is not None
    mask = cv2.imread(str(small / "mask_left.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    v, u = np.nonzero(cv2.distanceTransform((mask > 127).astype(np.uint8), cv2.DIST_L2, 3) > 1)
    network = ("--promptable-encoder", files.encoder, "--promptable-decoder", files.decoder)
    at = str(u[len(u) // 2]), str(v[len(v) // 2])
    ended = suturegrasp(*pair(small), "--output", out, "--segmenter", "promptable", *network, "--pixel", *at)
    assert (ended.status, ended.complaints) == (0, [])
    assert json.loads(out.read_text())["segmenter"] == "promptable"


def test_reconstruct_says_what_is_wrong_in_one_line(suturegrasp, small, pair, tmp_path):
    files = "--promptable-encoder a.onnx --promptable-decoder b.onnx"
    for options, told in (
        ("--segmenter promptable", "--segmenter promptable needs --promptable-encoder and --promptable-decoder"),
        ("--promptable-encoder a.onnx", "give both --promptable-encoder and --promptable-decoder, or neither"),
        (f"--segmenter promptable {files}", "promptable_encoder a.onnx"),
    ):
        ended = suturegrasp(*pair(small), "--output", tmp_path / "thread.json", *options.split())
        assert (ended.status, len(ended.err.splitlines())) == (2, 1)
        assert told in ended.err


def test_a_prompt_that_is_no_pixel_is_said_in_one_line(suturegrasp):
    for options, told in (
        ("--pixel 1", "--pixel needs U V"),
        ("--at 1,2", "suturegrasp prompt --at is suturegrasp prompt --pixel U V now"),
        ("--pixel nan 2", "--pixel nan 2 is none; give two finite numbers"),
    ):
        ended = suturegrasp("prompt", *options.split())
        assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1)
        assert told in ended.err
