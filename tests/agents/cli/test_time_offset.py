"""A recording whose camera is late by its arm's clock, as `inspect` tells it, and a rig's, as `doctor` does."""

import json

import cv2
import numpy as np
import pytest

from agents.diagnostics.doctor.time_offset import Watch, finding
from agents.session_report.time_offsets import time_offsets
from schemas.messages import ImageEncoding, RobotMode, RobotState, StereoFrame
from schemas.topics import FRAMES, ROBOT_STATE
from shared.calibration.time_offset import windows_of
from shared.images import encode_image
from tests.agents.session_report.conftest import Maker, ns, stamp
from tests.shared.calibration.test_time_offset import Moves, measured, video

MOVES = Moves(2)
FIRST_S = 10.0
"""Before it there are states alone."""
pytestmark = pytest.mark.slow


def states(delay_s):
    motion = measured(MOVES, delay_s)
    for at_s, T in zip(motion.time_s + FIRST_S, motion.T_base_tool, strict=True):
        yield at_s, RobotState("psm1", ns(at_s), RobotMode.MOVING, T, np.zeros(6), 0.0, np.eye(4), "")


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """Its camera is 0.3 s late."""
    maker = Maker()
    for number, (at_s, grey) in enumerate(video(MOVES, 2)):
        image = encode_image(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), ImageEncoding.JPEG)
        maker.put(FRAMES, StereoFrame(stamp(number, FIRST_S + at_s), image, image), FIRST_S + at_s)
    for at_s, state in states(0.3):
        maker.put(ROBOT_STATE, state, at_s, "psm1")
    return maker.write(tmp_path_factory.mktemp("late") / "late.mcap")


def test_inspect_tells_how_late_the_camera_is(suturegrasp, late):
    ended = suturegrasp("inspect", late, "--time-offset", "--json")
    assert ended.status == 0, ended.err
    (told,) = json.loads(ended.out)["time_offsets"]
    assert (told["arm"], told["offset"]["delay_s"]) == ("psm1", pytest.approx(0.3, abs=0.01))
    table = suturegrasp("inspect", late, "--time-offset").out
    assert "+300 ms, 95 % within" in table
    assert "stamps are later" not in suturegrasp("inspect", late).out
    assert suturegrasp("inspect", late, late, "--time-offset").status == 2


def test_a_cut_by_what_was_told_is_aligned(suturegrasp, late, tmp_path):
    aligned = tmp_path / "aligned.mcap"
    assert suturegrasp("cut", late, "--output", aligned, "--delay", "psm1=300").status == 0
    (told,) = time_offsets(aligned)
    assert told.offset is not None
    assert told.offset.delay_s == pytest.approx(0.0, abs=0.01)


def test_doctor_names_the_latency_that_a_rig_should_have():
    windows = list(windows_of(video(MOVES, 2)))
    for delay_s, latency_ms, said in (
        (0.2, 0.0, "set latency_ms of [camera] to 200,"),
        (0.2, 50.0, "set latency_ms of [camera] to 250,"),
        (-0.2, 250.0, "set latency_ms of [camera] to 50,"),
        (-0.2, 0.0, "set the clocks of"),
        (0.0, 0.0, ""),
    ):
        motion = measured(MOVES, delay_s)
        of_arm = {
            round(1e9 * at_s): RobotState(
                "psm1", round(1e9 * (at_s + 100)), RobotMode.MOVING, T, np.zeros(6), 0.0, np.eye(4), ""
            )
            for at_s, T in zip(motion.time_s, motion.T_base_tool, strict=True)
        }
        shifted = [type(one)(one.time_s + 100, one.places_px) for one in windows]
        told = finding(Watch("psm1", of_arm, shifted), latency_ms)
        assert told.remedy.startswith(said) if said else not told.remedy, (delay_s, told)
    assert finding(Watch("psm1"), 0.0).state == "?"
