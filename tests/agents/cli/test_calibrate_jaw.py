"""`calibrate jaw` from a recording and from a rig, and the bridge that is built with what it wrote."""

import contextlib
import json
import threading
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.cli.calibrate.jaw import listened
from agents.cli.calibrate.options import Jaw
from agents.cli.recordings.recompute import with_simulated_arms
from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.robot_bridge.agent import RobotBridge
from schemas.codec import encode
from schemas.messages import RobotMode, RobotState
from schemas.topics import ROBOT_STATE, key
from shared.calibration import CalibrationError
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.recording.entry import Entry
from shared.recording.writer import RecordingWriter
from shared.runtime.config import ConfigError, parse_config
from shared.runtime.taps import Tapped
from tests.agents.cli.conftest import refused

EPOCH_NS, TOOL, CLOSES_RAD = 1_780_000_000 * 10**9, "LARGE_NEEDLE_DRIVER:400006", 0.12
DVRK = "backend = 'dvrk'\nT_camera_base = {T}\ndvrk = {{endpoint = 'tcp/127.0.0.1:7'}}"


def states(closings: int = 4, arm: str = "psm1", instrument: str = TOOL, zero_rad: float = 0.0, **changes: Any):
    """Of an arm whose jaw is opened and closed in a second each, stands open in between, and stops at CLOSES_RAD."""
    told = np.tile(
        np.concatenate((np.linspace(0.0, 0.8, 100), np.full(40, 0.8), np.linspace(0.8, -0.1, 100))), closings
    )
    told = np.append(told, np.full(120, -0.1))
    measured = np.maximum(told, CLOSES_RAD) + np.random.default_rng(1).normal(0, 5e-4, len(told))
    for i, (set_point, jaw) in enumerate(zip(told, measured, strict=True)):
        of_jaw: dict[str, Any] = {
            "jaw_set_point_rad": float(set_point),
            "jaw_zero_rad": zero_rad,
            "instrument": instrument,
        } | changes
        where = np.eye(4), np.zeros(6), float(jaw) - zero_rad, np.eye(4)
        yield RobotState(arm, EPOCH_NS + i * 10**7, RobotMode.DISABLED, *where, "", **of_jaw)


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., Path]:
    def write(told: Iterable[RobotState], name: str = "session.mcap") -> Path:
        writer = RecordingWriter(tmp_path / name)
        for number, state in enumerate(told):
            at = state.measured_ns
            name_of = key("lab", ROBOT_STATE, state.arm)
            writer.write(ROBOT_STATE, Entry(name_of, 1, number, encode(state), at, at))
        writer.close()
        return tmp_path / name

    return write


def built(text: str, change: Callable[[RigConfig], RigConfig] = lambda rig: rig, arm: str = "psm1") -> RobotBridge:
    agent = build(change(parse_config(text, RigConfig, "rig.toml")), "robot_bridge", arm)
    assert isinstance(agent, RobotBridge)
    return agent


@pytest.mark.parametrize("zero_rad", [0.0, 0.05])
def test_what_it_writes_of_a_recording_is_what_the_bridge_closes_by(suturegrasp, recorded, tmp_path, zero_rad):
    written = tmp_path / "jaw.json"
    ended = suturegrasp("calibrate", "jaw", recorded(states(zero_rad=zero_rad)), "--output", written)
    assert ended.status == 0, ended.err
    assert "4 of 4 closings met resistance" in ended.out
    assert f"({TOOL}) closes at 0.1" in ended.out
    assert json.loads(written.read_text())["made"].startswith("2026-")
    zero = built(f"[robot.psm1]\njaw_file = '{written}'\njaw_days = 7").config.jaw_zero
    assert zero is not None
    # measured by the console's own angles, whatever was taken off by a calibration before
    assert zero.closes_rad == pytest.approx(CLOSES_RAD, abs=1e-3)
    assert (zero.arm, zero.instrument, zero.closings) == ("psm1", TOOL, 4)
    assert 0 <= zero.made_ns - EPOCH_NS < 60 * 10**9
    refused(suturegrasp("calibrate", "jaw", tmp_path / "session.mcap", "--output", written), "exists already")


@pytest.mark.parametrize(
    ("told", "options", "sentence", "status"),
    [
        ({"closings": 2}, (), "2 closings, and 3 are needed", 3),
        ({"arm": "psm2"}, (), "it holds no state of an arm 'psm1'", 2),
        ({"jaw_set_point_rad": None}, (), "no state tells where the jaw was sent", 2),
        ({"instrument": ""}, (), "give --instrument", 2),
        ({}, ("--instrument", "other"), f"the console says that the instrument is {TOOL}, not other", 2),
        ({}, ("--live",), "give a recording, or --live", 2),
    ],
)
def test_what_cannot_be_told_gets_one_sentence(suturegrasp, recorded, told, options, sentence, status):
    refused(suturegrasp("calibrate", "jaw", recorded(states(**told)), *options), sentence, status=status)


def test_a_changed_instrument_and_no_recording_are_told(suturegrasp, recorded, tmp_path):
    both = [*states(1), *states(instrument="PROGRASP:400049")]
    refused(suturegrasp("calibrate", "jaw", recorded(both)), "the instrument was changed")
    (tmp_path / "none.mcap").write_text("x")
    refused(suturegrasp("calibrate", "jaw", tmp_path / "none.mcap"), "none.mcap")
    refused(suturegrasp("calibrate", "jaw", tmp_path / "missing.mcap"), "missing.mcap")


def test_an_instrument_that_the_console_does_not_tell_is_as_it_is_named(suturegrasp, recorded, tmp_path):
    written = tmp_path / "jaw.json"
    options = "--instrument", "needle driver 3", "--output", written
    assert suturegrasp("calibrate", "jaw", recorded(states(instrument="")), *options).status == 0
    assert json.loads(written.read_text())["instrument"] == "needle driver 3"


class Heard:
    """A rig that tells states as soon as somebody listens."""

    def __init__(self, told: Iterable[RobotState]) -> None:
        self._told = told

    @contextlib.contextmanager
    def listening(self, _topics: Any, receive: Callable[[Tapped], None]) -> Generator[None]:
        for state in self._told:
            receive(Tapped(ROBOT_STATE, key("lab", ROBOT_STATE, state.arm), encode(state), None))
        receive(Tapped(ROBOT_STATE, "", b"\xff", None))
        yield


def test_a_running_rig_is_listened_to_until_the_jaw_was_closed_often_enough(capsys):
    rig: Any = Heard([*states(3), *states(1, arm="psm2")])
    told = listened(rig, Jaw(live=True, closings=3), threading.Event())
    assert {state.arm for state in told} == {"psm1"}
    assert "3 of 3 closings" in capsys.readouterr().out


def test_a_rig_whose_arm_is_silent_is_told_so():
    rig: Any = Heard(states(arm="psm2"))
    with pytest.raises(CalibrationError, match="no state of psm1 comes: see that its robot bridge runs"):
        listened(rig, Jaw(live=True), threading.Event())


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"arm": "psm2"}, "is of psm2, and this is psm1"),
        ({"instrument": "PROGRASP:400049"}, f"is of PROGRASP:400049, and this is {TOOL}"),
        ({"closes_rad": 5.7}, "are they in degrees"),
    ],
)
def test_a_bridge_does_not_start_with_the_jaw_of_another_arm_or_instrument_or_none(tmp_path, changes, told):
    written = tmp_path / "jaw.json"
    found = {"arm": "psm1", "instrument": TOOL, "closes_rad": 0.1, "told_rad": 0.1, "deviation_rad": 0.01}
    written.write_text(json.dumps(found | {"closings": 5} | changes))
    text = f"[robot.psm1]\njaw_file = '{written}'\n{DVRK.format(T=SIMULATED_T_CAMERA_BASE.tolist())}"
    with pytest.raises(ConfigError, match=rf"robot\.psm1\.jaw_file: .*{told}"):
        built(text)
    # a replay has a simulated arm in its place, and needs no file
    assert built(text, with_simulated_arms).config.jaw_zero is None
