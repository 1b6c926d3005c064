"""Where perception looks for a needle, and that it does so where somebody asks for it."""

from pathlib import Path

import numpy as np
import pytest

from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.needle import needle_region
from schemas.codec import decode
from schemas.messages import Occluder
from schemas.topics import CALIBRATION, FRAMES, NEEDLE_SEEN, topic_of
from shared.recording.mcap_file import read_recording
from shared.runtime.agent import Received, outputs_in

TISSUE = Path(__file__).parents[2] / "goldens" / "tissue.mcap"


def test_a_needle_is_looked_for_around_where_a_small_copy_shows_one_and_around_the_ends_of_the_thread():
    occluders = np.zeros((135, 240), np.uint8)
    occluders[20, 30] = Occluder.NEEDLE.value
    occluders[100, 200] = Occluder.TOOL.value
    where = needle_region((540, 960), occluders, np.array([[900.0, 80.0], [-5.0, 600.0]]))
    at = [(80, 120), (80, 900), (530, 10), (400, 800), (300, 480)]
    assert [bool(where[row, column]) for row, column in at] == [True, True, True, False, False]


@pytest.mark.parametrize("needle", [False, True])
def test_lines_of_a_needle_are_told_where_an_agent_wants_them(needle):
    perception, told = Perception(PerceptionConfig(needle=needle)), []
    for entry in read_recording(TISSUE):
        topic = topic_of(entry.key)
        if topic in (CALIBRATION, FRAMES):
            message = decode(topic.message, entry.payload)
            outputs = outputs_in(perception.step(Received(topic, entry.key, entry.sequence, message)))
            told += [output.message for output in outputs if output.topic is NEEDLE_SEEN]
    assert bool(told) is needle
    for seen in told:
        # there is none, and what is there is thread
        assert len(seen.left.lines.point_px) > 100
        assert seen.left.needle.mean() < 0.1
