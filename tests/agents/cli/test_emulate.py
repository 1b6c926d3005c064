"""`emulate dvrk` as a process: arms of one console, what is asked of it, and what it says at its end."""

import json
import subprocess
from contextlib import closing

import pytest

from shared.ros import crtk
from shared.ros.link import Heard, RosLink
from shared.ros.naming import RmwZenoh, Ros2dds
from shared.ros.types import JOINT_STATE, OPERATING_STATE
from shared.runtime.session import SessionSettings, free_local_endpoint
from tests.agents.cli.conftest import SCRIPT

ARMS = ("PSM1", "PSM2")


@pytest.mark.rig
@pytest.mark.parametrize("codec", ["ros2dds", "rmw_zenoh"])
def test_two_arms_of_one_console_are_told_asked_and_judged_each(codec, suturegrasp, tmp_path, until):
    endpoint, joints, states = free_local_endpoint(), {}, {}

    def heard(arm):
        yield Heard(f"{arm}/measured_js", JOINT_STATE, lambda data, _: joints.update({arm: crtk.joints(data).position}))
        kept = lambda data, _: states.update({arm: crtk.operating_state(data)})  # noqa: E731
        yield Heard(f"{arm}/operating_state", OPERATING_STATE, kept, latched=True)

    console = ("emulate", "dvrk", "--arm", ",".join(ARMS), "--listen", endpoint)
    command = [SCRIPT, *console, "--ready", "--codec", codec, "--verdict", str(tmp_path / "verdict.json")]
    naming = Ros2dds() if codec == "ros2dds" else RmwZenoh()
    topics = tuple(topic for arm in ARMS for topic in heard(arm))
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE) as process,
        closing(RosLink(SessionSettings(endpoint=endpoint), naming, topics)) as link,
    ):
        link.open()
        until(lambda: set(joints) == set(states) == set(ARMS))
        assert joints["PSM1"][0] == -joints["PSM2"][0] != 0, "on both sides of the endoscope"
        assert {state.state for state in states.values()} == {"ENABLED"}
        told = suturegrasp(*console, "--tell", "fault")
        assert told.status == 0, told.err
        until(lambda: {state.state for state in states.values()} == {"FAULT"})
        process.terminate()
        assert process.wait(60.0) == 0
    verdict = json.loads((tmp_path / "verdict.json").read_text())
    assert (verdict["unsafe"], len(verdict["arms"])) == (0, 2)
