"""Robot bridge and guard as processes beside an emulated dVRK that is one; in mid-motion bridge or link are lost."""

import contextlib
import json
import os
import signal
import subprocess
import sys

import pytest

from shared.clock import now_ns
from tests.rigs.robot.lab import Lab

pytestmark = pytest.mark.rig
DEADLINE_S = 60.0
LATER_MS = 1500


@pytest.fixture
def lab(tmp_path, monkeypatch, request):
    """An emulated console with everything that leads to it, by some codec; the arm moves."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    with contextlib.ExitStack() as stack:
        lab = stack.enter_context(contextlib.closing(Lab(tmp_path, {"codec": request.param}, stack)))
        lab.move()
        yield lab


@pytest.mark.essential
@pytest.mark.parametrize("lab", ["rmw_zenoh"], indirect=True)
def test_a_bridge_that_is_killed_leaves_the_arm_at_its_last_set_point_and_the_guard_holds_it(lab, tmp_path, until):
    killed_ns = now_ns()
    lab.lose("bridge")
    until(lambda: lab.verdict()["held_ns"] > killed_ns)
    last = lab.still(killed_ns)
    assert last["position"] == last["goal"], "the last set point is held"
    assert (last["unsafe"], last["state"]) == (0, "ENABLED"), last["sentences"]
    command = [sys.executable, "-m", "agents.cli", "guard", "--config", str(tmp_path / "guard.json")]
    second = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=DEADLINE_S, check=False)
    assert second.returncode == 1, "one guard goes on, and the other one ends"
    assert b"another guard of psm1 runs already" in second.stdout + second.stderr
    assert "hold, for set points have ended" in (tmp_path / "guard.log").read_text()
    bridges, guards = (
        [json.loads(line) for line in (tmp_path / "audit" / f"{name}-psm1.jsonl").read_text().splitlines()]
        for name in ("robot_bridge", "guard")
    )
    assert "accepted" in {line.get("kind") for line in bridges}, "what a killed bridge was armed for is written down"
    assert "stopped" not in {line["what"] for line in bridges}
    assert guards[-1]["what"] == "hold"


@pytest.mark.parametrize("lab", ["ros2dds"], indirect=True)
@pytest.mark.parametrize("lost", ["link of the robot", "bridge"])
def test_what_a_link_or_a_bridge_that_stood_still_had_under_way_is_not_executed_when_it_goes_on(lab, lost, until):
    lost_ns = now_ns()
    os.kill(lab.pid(lost), signal.SIGSTOP)
    until(lambda: lab.verdict()["held_ns"] > lost_ns)
    before = lab.still(lost_ns)
    lab.signal("operator")
    os.kill(lab.pid(lost), signal.SIGCONT)
    on_ns = now_ns()
    until(lambda: now_ns() - on_ns > LATER_MS * 10**6)
    after = lab.verdict()
    assert (after["set_points"], after["moved_ns"]) == (before["set_points"], before["moved_ns"])
    assert after["unsafe"] == 0, after["sentences"]
