"""Robot bridge and guard as processes beside an emulated dVRK that is one; in mid-motion bridge or link are lost."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from agents.launch.supervisor import SUPERVISED
from schemas.codec import decode, encode
from schemas.messages import ChallengeEcho, ExecutionEvent, ExecutionKind, FrameStamp, Outcome
from schemas.topics import EXECUTION, PLAN, ROBOT_STATE, key
from shared.clock import now_ns
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import Connection
from shared.runtime.delivery import declare_publisher
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session
from tests.agents.robot_bridge.drive import SHORT_GRASP, plan
from tests.rigs.robot.lab import today
from tests.rigs.robot.person import Camera, Person

pytestmark = pytest.mark.rig
DEADLINE_S = 60.0
STILL_MS, LATER_MS = 100, 1500


@pytest.fixture
def started(tmp_path):
    """Start commands; what still runs is stopped at the end."""
    running = []

    def start(*arguments, module="agents.cli"):
        with (tmp_path / f"{arguments[0]}.log").open("ab") as log:
            command = [sys.executable, "-m", module, *map(str, arguments)]
            environment = {**os.environ, SUPERVISED: "1", "STATE_DIRECTORY": str(tmp_path), "PYTHONFAULTHANDLER": "1"}
            running.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=log, stderr=log, env=environment))
        return running[-1]

    yield start
    for process in running:
        process.send_signal(signal.SIGCONT)
        process.terminate()
    stuck = [process for process in running if not ended(process)]
    assert not stuck, [(process.args, (tmp_path / f"{process.args[3]}.log").read_text()) for process in stuck]


def ended(process):
    """Whether a process that was told to end has; one that has not says where it stands, and is ended."""
    with contextlib.closing(process.stdin):
        try:
            process.wait(DEADLINE_S)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)
            process.wait(DEADLINE_S)
            return False
    return True


class Begun(NamedTuple):
    """Processes around an emulated console, and an operator who arms the plan again whenever it was held.

    Fields:
        relay: through which alone the bridge reaches the console.
        verdict: what the console says now.
        log: what a process has said so far.
    """

    bridge: subprocess.Popen[bytes]
    emulator: subprocess.Popen[bytes]
    relay: subprocess.Popen[bytes]
    config: Path
    verdict: Callable[[], dict[str, Any]]
    log: Callable[[str], str]
    stopped: threading.Event


def written(folder, name, router, robot, codec):
    """A rig's file with the console there, and the base that the console judges by."""
    base = {"T_camera_base": SIMULATED_T_CAMERA_BASE.tolist()}
    (folder / "base.json").write_text(json.dumps(base))
    untold = {"dry_run": False, "has_no": ["teleoperation", "endoscope_arm", "clutch", "tissue"]}
    told = {"T_camera_base_calibration": "c", "T_camera_base_made": today()}
    arm = base | told | {"backend": "dvrk", "dvrk": untold | {"endpoint": robot, "codec": codec}}
    rig = {"router": {"endpoint": router, "start": False}, "robot": {"psm1": arm}}
    (folder / name).write_text(json.dumps(rig))
    return folder / name


@pytest.fixture
def codec():
    return "ros2dds"


@pytest.fixture
def begun(started, tmp_path, codec, until):
    """Until the end of a test; the arm is about to move."""
    (router, robot, relayed), stopped = (free_local_endpoint() for _ in range(3)), threading.Event()
    config = written(tmp_path, "guard.json", router, robot, codec)
    with contextlib.ExitStack() as stack:
        stack.enter_context(open_router(router))
        judged = ("--camera", tmp_path / "base.json", "--heartbeats", router, "--verdict", tmp_path / "verdict.json")
        emulator = started("emulate", "dvrk", "--ready", "--codec", codec, "--listen", robot, *judged)
        relay = started(*(endpoint.rsplit(":", 1)[1] for endpoint in (relayed, robot)), module="tests.rigs.robot.relay")
        bridge = started("run", "robot-bridge", "--config", written(tmp_path, "rig.json", router, relayed, codec))
        started("guard", "--config", config)
        settings = SessionSettings(endpoint=router)
        session = stack.enter_context(open_session(settings))
        beside = stack.enter_context(open_session(SessionSettings(endpoint=robot)))
        connection = stack.enter_context(contextlib.closing(Connection(session, settings)))
        plans = declare_publisher(session, key("lab", PLAN), PLAN)
        states, ends = [], queue.Queue()
        connection.listen((ROBOT_STATE,), lambda tapped: states.append(tapped.key))
        connection.listen((EXECUTION,), ends.put)
        person = stack.enter_context(contextlib.closing(Person(connection, "psm1")))
        stack.enter_context(contextlib.closing(Camera(connection, "psm1", "c")))

        def verdict():
            replies = list(beside.get("emulator/PSM1/verdict", timeout=5.0))
            return json.loads(replies[0].ok.payload.to_string()) if replies and replies[0].ok else {"set_points": 0}

        def operate():
            # on a busy machine a motion may be held, which is right, and is begun again
            sequence = 0
            while not stopped.is_set():
                at_ns = now_ns()
                stamp = FrameStamp(1, at_ns, at_ns, "c", (ChallengeEcho("psm1", at_ns),))
                made = plan("p", stamp=stamp, waypoints=SHORT_GRASP)
                plans.put(encode(made), attachment=pack(Attachment(1, sequence, at_ns, 0.0)))
                if person.press("p").outcome is Outcome.ACCEPTED:
                    while not stopped.is_set() and not _ended(ends, person.arming_id):
                        pass
                    person.release()
                sequence += 1

        def log(name):
            return (tmp_path / f"{name}.log").read_text()

        until(lambda: states)
        operator = threading.Thread(target=operate)
        operator.start()
        stack.callback(lambda: (stopped.set(), operator.join()))
        yield Begun(bridge, emulator, relay, config, verdict, log, stopped)


def _ended(ends, arming_id):
    """Whether an event within a moment says that the motion of an arming has ended."""
    try:
        event = decode(ExecutionEvent, ends.get(timeout=0.1).payload)
    except queue.Empty:
        return False
    return event.arming_id == arming_id and event.kind in (ExecutionKind.FINISHED, ExecutionKind.HELD)


def lines(folder, name):
    """What is written down of an arm."""
    return [json.loads(line) for line in (folder / "audit" / f"{name}-psm1.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("codec", ["rmw_zenoh"])
@pytest.mark.essential
def test_a_bridge_that_is_killed_leaves_the_arm_at_its_last_set_point_and_the_guard_holds_it(
    begun, started, tmp_path, until
):
    verdict = begun.verdict
    until(lambda: verdict()["set_points"] > 100)
    killed_ns = now_ns()
    begun.bridge.send_signal(signal.SIGKILL)
    until(lambda: verdict()["held_ns"] > killed_ns)
    until(lambda: now_ns() - verdict()["moved_ns"] > STILL_MS * 10**6)
    second = started("guard", "--config", begun.config)
    assert second.wait(DEADLINE_S) == 1, "one guard goes on, and the other one ends"
    last = verdict()
    assert last["position"] == last["goal"], "the last set point is held"
    assert (last["unsafe"], last["state"]) == (0, "ENABLED"), last["sentences"]
    begun.stopped.set()
    begun.emulator.terminate()
    assert begun.emulator.wait(DEADLINE_S) == 0
    assert json.loads((tmp_path / "verdict.json").read_text())["unsafe"] == 0
    assert "hold, for set points have ended" in begun.log("guard")
    assert "another guard of psm1 runs already" in begun.log("guard")
    bridges, guards = (lines(tmp_path, name) for name in ("robot_bridge", "guard"))
    assert "accepted" in {line.get("kind") for line in bridges}, "what a killed bridge was armed for is written down"
    assert "stopped" not in {line["what"] for line in bridges}
    assert guards[-1]["what"] == "hold"


@pytest.mark.parametrize("lost", ["relay", "bridge"])
def test_what_a_link_or_a_bridge_that_stood_still_had_under_way_is_not_executed_when_it_goes_on(begun, lost, until):
    verdict, process = begun.verdict, getattr(begun, lost)
    until(lambda: verdict()["set_points"] > 100)
    lost_ns = now_ns()
    process.send_signal(signal.SIGSTOP)
    until(lambda: verdict()["held_ns"] > lost_ns)
    until(lambda: now_ns() - verdict()["moved_ns"] > STILL_MS * 10**6)
    begun.stopped.set()
    before = verdict()
    process.send_signal(signal.SIGCONT)
    on_ns = now_ns()
    until(lambda: now_ns() - on_ns > LATER_MS * 10**6)
    after = verdict()
    assert (after["set_points"], after["moved_ns"]) == (before["set_points"], before["moved_ns"])
    assert after["unsafe"] == 0, after["sentences"]
