"""The guard as a command: what it refuses in one sentence, what its monitor loads, what happens when a link is lost."""

import json
import signal
import subprocess
import sys
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.configuration.rig import RigConfig
from agents.configuration.sections import ArmSection, DvrkSection, RouterSection
from agents.launch.audit import AuditLog
from agents.launch.guard_process import _another, _Keeper, document_of
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.ros.guarded import CHALLENGE, Gate, challenge_from, key_of
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session
from tests.agents.cli.conftest import refused

ARM = {"backend": "dvrk", "T_camera_base": np.eye(4).tolist()}
FAR = {"endpoint": "tls/10.0.0.13:7448", "through_guard": True}
HOSTS = {
    "desk": {"address": "10.0.0.11", "runs": ["robot_bridge psm1"]},
    "robot": {"address": "10.0.0.13", "runs": ["guard psm1"]},
}
SECURED = {"hosts": HOSTS, "host": "robot", "router": {"host": "desk"}, "security": {}}
DEADLINE_S = 30.0


@pytest.mark.parametrize(
    ("rig", "told"),
    [
        ({"robot": {"psm1": {}}}, "has no section [robot.psm1.dvrk]: there is nothing to guard"),
        ({"robot": {"psm1": ARM | {"dvrk": FAR}}}, "leaves this machine, which needs tls and [security]"),
        (SECURED | {"robot": {"psm1": ARM | {"dvrk": FAR}}}, "suturegrasp deploy certificates makes it"),
        (
            SECURED | {"robot": {"psm1": ARM | {"dvrk": FAR | {"through_guard": False}}}},
            "set points go through the guard always",
        ),
    ],
)
def test_what_cannot_be_guarded_or_reached_safely_is_one_sentence(suturegrasp, tmp_path, rig, told):
    config = tmp_path / "rig.json"
    config.write_text(json.dumps(rig))
    refused(suturegrasp("guard", "--config", config), told)


@pytest.fixture
def links():
    """Endpoints of a rig and of a robot, and the document by which a monitor there begins."""
    rig, robot = free_local_endpoint(), free_local_endpoint()
    section = DvrkSection(endpoint=robot)
    arm = ArmSection(backend="dvrk", T_camera_base=SIMULATED_T_CAMERA_BASE.tolist(), dvrk=section)
    config = RigConfig(router=RouterSection(endpoint=rig, start=False), robot={"psm1": arm})
    return rig, robot, document_of(config, "psm1", section)


@pytest.mark.slow
def test_the_monitor_loads_no_numpy_and_ends_with_its_input_whatever_signal_comes(links):
    rig, robot, document = links
    command = [sys.executable, "-m", "agents.guard"]
    with (
        open_router(rig),
        open_router(robot),
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as monitor,
    ):
        assert monitor.stdin is not None and monitor.stdout is not None
        print(json.dumps(document), file=monitor.stdin, flush=True)
        assert json.loads(monitor.stdout.readline()) == {"what": "guards", "modules": False}
        # who started it is told by the same signal, and ends its input
        monitor.send_signal(signal.SIGINT)
        monitor.send_signal(signal.SIGTERM)
        assert [json.loads(monitor.stdout.readline())["what"] for _ in range(2)] == ["alive", "alive"]
        monitor.stdin.close()
        assert monitor.wait(DEADLINE_S) == 0


def test_the_monitor_depends_on_nothing_but_zenoh_and_the_messages():
    listed = "import sys, agents.guard.__main__; print(*sys.modules, sep='\\n')"
    loaded = subprocess.run(
        [sys.executable, "-c", listed], capture_output=True, text=True, check=True, timeout=DEADLINE_S
    ).stdout.split()
    own = {name for name in loaded if name.startswith(("agents.", "shared.", "schemas."))}
    assert own == {
        *(f"agents.guard{name}" for name in ("", ".__main__", ".cdr", ".description", ".links", ".monitor")),
        *("shared.clock", "shared.ros", "shared.ros.guarded"),
    }
    assert not {"numpy", "scipy", "cv2", "rerun", "piqp", "mcap"} & set(loaded)


@pytest.mark.slow
def test_it_ends_where_the_robots_zenoh_is_lost_and_another_one_guards_when_that_is_back(links, tmp_path, until):
    rig, robot, document = links
    stopped, audit = threading.Event(), AuditLog(tmp_path / "guard.jsonl")
    keeper = _Keeper("PSM1", document, audit, stopped)
    with open_router(rig):
        kept = threading.Thread(target=keeper.run)
        try:
            with open_router(robot):
                kept.start()
                until(lambda: not keeper.fault, "the monitor guards")
                assert hears_challenges(robot)
            until(lambda: "was lost" in keeper.fault, "the loss is told")
            with open_router(robot):
                until(lambda: not keeper.fault, "another monitor guards")
                assert hears_challenges(robot)
                stopped.set()
                kept.join(DEADLINE_S)
        finally:
            stopped.set()
            kept.join(DEADLINE_S)
    assert (kept.is_alive(), keeper.gave_up) == (False, "")


def hears_challenges(robot):
    """Whether a bridge would be asked there, by a shut gate."""
    heard, own = threading.Event(), key_of("PSM1", CHALLENGE)

    def hear(sample):
        told = challenge_from(str(sample.key_expr), sample.payload.to_bytes())
        assert told.gate is Gate.SHUT
        heard.set()

    with open_session(SessionSettings(endpoint=robot)) as session:
        subscriber = session.declare_subscriber(own, hear)
        found = heard.wait(DEADLINE_S)
        subscriber.undeclare()
    return found


def test_a_monitor_that_cannot_begin_says_so_and_is_not_started_again_for_ever(links, tmp_path):
    stopped = threading.Event()
    broken = links[2] | {"description": {"arm": "psm1"}}
    keeper = _Keeper("PSM1", broken, AuditLog(tmp_path / "guard.jsonl"), stopped)
    keeper.run()
    assert "the monitor has ended with status 1" in keeper.gave_up
    assert stopped.is_set()


def test_a_second_guard_of_an_arm_gives_up_and_one_that_was_killed_is_waited_for(monkeypatch):
    monkeypatch.setattr("agents.launch.guard_process.TWIN_S", 0.0)

    own = {"guard/psm1"}
    for present, stays in (((own, own), True), ((own, set()), False), (({"guard/psm2"},), False)):
        connection: Any = SimpleNamespace(present=iter(present).__next__)
        assert _another(connection, "guard/psm1", threading.Event()) is stays
