"""The guard as a command: what it refuses in one sentence, what it passes on, and on how little it depends."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest

from agents.cli.running.guard import _Ears
from agents.guard.gate import LEARNT_NS
from agents.guard.watch import NOBODY_NS
from shared.ros import crtk

MS = 10**6

ARM = {"backend": "dvrk", "T_camera_base": np.eye(4).tolist()}
FAR = {"endpoint": "tls/10.0.0.13:7448", "through_guard": True}
HOSTS = {
    "desk": {"address": "10.0.0.11", "runs": ["robot_bridge psm1"]},
    "robot": {"address": "10.0.0.13", "runs": ["guard psm1"]},
}
SECURED = {"hosts": HOSTS, "host": "robot", "router": {"host": "desk"}, "security": {}}


@pytest.mark.parametrize(
    ("rig", "told"),
    [
        ({"robot": {"psm1": {}}}, "has no section [robot.psm1.dvrk]: there is nothing to guard"),
        ({"robot": {"psm1": ARM | {"dvrk": FAR}}}, "leaves this machine, which needs tls and [security]"),
        (SECURED | {"robot": {"psm1": ARM | {"dvrk": FAR}}}, "suturegrasp deploy certificates makes certificates"),
        (
            SECURED | {"robot": {"psm1": ARM | {"dvrk": FAR | {"through_guard": False}}}},
            "set through_guard = true, and run suturegrasp guard on the robot's computer",
        ),
    ],
)
def test_what_cannot_be_guarded_or_reached_safely_is_one_sentence(suturegrasp, tmp_path, rig, told):
    config = tmp_path / "rig.json"
    config.write_text(json.dumps(rig))
    ended = suturegrasp("guard", "--config", config)
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1)
    assert told in ended.err


def test_what_is_fresh_passes_to_the_console_only_while_somebody_stands_by():
    passed, ears, at_ns = list[str](), _Ears("psm1", "PSM1"), 10**18
    ears.pass_on = lambda topic, _data: passed.append(topic)
    hear = ears.gating("servo_jp")

    def point(after_ms):
        hear(crtk.joint_command(np.zeros(6), at_ns + after_ms * MS), at_ns + after_ms * MS)

    for after_ms in range(0, LEARNT_NS // MS + 200, 100):
        ears.hear_alive(crtk.joint_command(np.zeros(1), at_ns + after_ms * MS), at_ns + after_ms * MS)
    point(1200)
    assert not passed
    ears._heard = dataclasses.replace(ears._heard, heartbeat_ns=at_ns + 1200 * MS)
    point(1205)
    assert passed == ["PSM1/servo_jp"]
    point(1201 + NOBODY_NS // MS)
    assert len(passed) == 1


def test_it_depends_on_neither_cameras_nor_planning_nor_the_bridge():
    listed = "import sys, agents.cli.running.guard; print(*sys.modules, sep='\\n')"
    loaded = subprocess.run(
        [sys.executable, "-c", listed], capture_output=True, text=True, check=True, timeout=60
    ).stdout
    kinds = {name.split(".")[1] for name in loaded.split() if name.startswith("agents.") and name.count(".") > 1}
    assert "guard" in kinds
    assert not kinds & {"camera", "perception", "planner", "simulator", "viewer", "recorder"}
    assert not {"agents.robot_bridge.agent", "agents.robot_bridge.motion"} & set(loaded.split())
    assert not {"cv2", "rerun", "piqp", "mcap"} & set(loaded.split())
