"""Robot bridge and guard as processes beside an emulated dVRK that is one; the bridge is killed in mid-motion."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading

import pytest

from agents.cli.supervisor import SUPERVISED
from agents.operator.operator import arm_and_stand_by
from schemas.codec import encode
from schemas.topics import PLAN, ROBOT_STATE, key
from shared.clock import monotonic_s, now_ns
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import Connection
from shared.runtime.delivery import declare_publisher
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session

DEADLINE_S = 60.0
STILL_MS = 100


@pytest.fixture
def started(tmp_path):
    """Start commands; what still runs is stopped at the end."""
    running = []

    def start(*arguments):
        with (tmp_path / f"{arguments[0]}.log").open("ab") as log:
            command = [sys.executable, "-m", "agents.cli", *map(str, arguments)]
            environment = {**os.environ, SUPERVISED: "1", "STATE_DIRECTORY": str(tmp_path)}
            running.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=log, stderr=log, env=environment))
        return running[-1]

    yield start
    for process in running:
        process.terminate()
    for process in running:
        process.wait(DEADLINE_S)
        process.stdin.close()


def until(condition, what):
    deadline_s, turn = monotonic_s() + DEADLINE_S, threading.Event()
    while not condition():
        assert monotonic_s() < deadline_s, what()
        turn.wait(0.02)


def test_a_bridge_that_is_killed_leaves_the_arm_at_its_last_set_point_and_the_guard_holds_it(
    started, tmp_path, plan_of
):
    router, robot, stopped = free_local_endpoint(), free_local_endpoint(), threading.Event()
    base = {"T_camera_base": SIMULATED_T_CAMERA_BASE.tolist()}
    (tmp_path / "base.json").write_text(json.dumps(base))
    arm = base | {"backend": "dvrk", "dvrk": {"endpoint": robot, "dry_run": False, "through_guard": True}}
    rig = {"router": {"endpoint": router, "start": False}, "robot": {"psm1": arm}}
    config = tmp_path / "rig.json"
    config.write_text(json.dumps(rig))
    with contextlib.ExitStack() as stack:
        stack.enter_context(open_router(router))
        judged = ("--camera", tmp_path / "base.json", "--heartbeats", router, "--verdict", tmp_path / "verdict.json")
        emulator = started("emulate", "dvrk", "--ready", "--listen", robot, *judged)
        bridge = started("robot-bridge", "--config", config)
        started("guard", "--config", config)
        settings = SessionSettings(endpoint=router)
        session = stack.enter_context(open_session(settings))
        beside = stack.enter_context(open_session(SessionSettings(endpoint=robot)))
        connection = stack.enter_context(contextlib.closing(Connection(session, settings)))
        plans = declare_publisher(session, key("lab", PLAN), PLAN)
        states = []
        connection.listen((ROBOT_STATE,), lambda tapped: states.append(tapped.key))

        def verdict():
            replies = list(beside.get("emulator/PSM1/verdict", timeout=5.0))
            return json.loads(replies[0].ok.payload.to_string()) if replies and replies[0].ok else {"set_points": 0}

        def operate():
            # on a busy machine a motion may be held, which is right, and is begun again
            sequence = 0
            while not stopped.is_set():
                plans.put(encode(plan_of("p", now_ns())), attachment=pack(Attachment(1, sequence, now_ns(), 0.0)))
                arm_and_stand_by(connection, "psm1", "p", stopped, lambda _event: None)
                sequence += 1

        until(lambda: states, lambda: (tmp_path / "robot-bridge.log").read_text())
        operator = threading.Thread(target=operate)
        operator.start()
        stack.callback(lambda: (stopped.set(), operator.join()))
        until(lambda: verdict()["set_points"] > 100, lambda: (tmp_path / "robot-bridge.log").read_text())
        killed_ns = now_ns()
        bridge.send_signal(signal.SIGKILL)
        until(lambda: verdict()["held_ns"] > killed_ns, lambda: (tmp_path / "guard.log").read_text())
        until(lambda: now_ns() - verdict()["moved_ns"] > STILL_MS * 10**6, verdict)
        second = started("guard", "--config", config)
        assert second.wait(DEADLINE_S) == 1, "one guard goes on, and the other one ends"
        last = verdict()
        assert last["position"] == last["goal"], "the last set point is held"
        assert (last["unsafe"], last["state"]) == (0, "ENABLED"), last["sentences"]
        stopped.set()
        emulator.terminate()
        assert emulator.wait(DEADLINE_S) == 0
    assert json.loads((tmp_path / "verdict.json").read_text())["unsafe"] == 0
    assert "hold, for set points have ended" in (tmp_path / "guard.log").read_text()
    assert "another guard of psm1 runs already" in (tmp_path / "guard.log").read_text()
    bridges, guards = (
        [json.loads(line) for line in (tmp_path / "audit" / f"{name}-psm1.jsonl").read_text().splitlines()]
        for name in ("robot_bridge", "guard")
    )
    assert "accepted" in {line.get("kind") for line in bridges}, "what a killed bridge was armed for is written down"
    assert "stopped" not in {line["what"] for line in bridges}
    assert guards[-1]["what"] == "hold"
