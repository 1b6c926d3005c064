"""The guard as a command: what it refuses in one sentence."""

import json

import numpy as np
import pytest

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
