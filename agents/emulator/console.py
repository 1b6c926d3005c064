"""The computer of an emulated dVRK: one arm, its topics, the oracle, and what may be asked of it.

Beside the topics of CRTK it answers, under `emulator/{arm}/`, `verdict` (JSON: the oracle's, and when what happened),
and takes on `request` a word: `fault`, `error`, `stick`, `loose`, `mute`, `speak`.
"""

import json
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import zenoh

from agents.emulator.arm import EmulatedArm
from agents.emulator.geometry import tool
from agents.emulator.messages import (
    Bool,
    Empty,
    Float64,
    JointState,
    OperatingState,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    String,
    StringStamped,
    header,
)
from agents.emulator.oracle import Circumstances, Oracle
from agents.emulator.wire import Outlet, Wire
from shared.clock import monotonic_s, now_ns

STATE_HZ, TURNS_PER_STATE = 100.0, 2
JOINTS = ["outer_yaw", "outer_pitch", "outer_insertion", "outer_roll", "outer_wrist_pitch", "outer_wrist_yaw"]
TOOL_TYPE = "LARGE_NEEDLE_DRIVER:400006"
SENSOR, STD, CRTK, GEOMETRY = (f"{name}_msgs::msg::dds_::" for name in ("sensor", "std", "crtk", "geometry"))
MOTIONS = {
    "servo_jp": ("arm", False),
    "move_jp": ("arm", True),
    "jaw/servo_jp": ("jaw", False),
    "jaw/move_jp": ("jaw", True),
}


class EmulatedConsole:
    """One arm on a wire, from construction until `close`; `run` lets its time pass."""

    def __init__(self, session: zenoh.Session, wire: Wire, name: str, oracle: Oracle, ready: bool) -> None:
        self._wire, self._name, self._oracle = wire, name, oracle
        self._lock, self._muted = threading.Lock(), False
        self._arm = EmulatedArm(ready, self._warn)
        self._told: tuple[object, ...] = ()
        self._times = {"moved_ns": 0, "set_point_ns": 0, "held_ns": 0}
        self._holds_ns: list[int] = []
        self._arrivals: list[float] = []
        self._held = True
        self._outlets: dict[str, Outlet] = {}
        for topic, kind, latched in (
            ("measured_js", f"{SENSOR}JointState_", False),
            ("setpoint_js", f"{SENSOR}JointState_", False),
            ("jaw/measured_js", f"{SENSOR}JointState_", False),
            ("jaw/setpoint_js", f"{SENSOR}JointState_", False),
            ("local/measured_cp", f"{GEOMETRY}PoseStamped_", False),
            ("measured_cp", f"{GEOMETRY}PoseStamped_", False),
            ("setpoint_cp", f"{GEOMETRY}PoseStamped_", False),
            ("operating_state", f"{CRTK}OperatingState_", True),
            ("error", f"{STD}String_", True),
            ("warning", f"{STD}String_", True),
            ("tool_type", f"{STD}String_", True),
            ("goal_reached", f"{STD}Bool_", False),
        ):
            self._outlets[topic] = wire.publish(f"{name}/{topic}", kind, latched)
        self._say("tool_type", String(TOOL_TYPE))
        self._tell_state()
        for topic in MOTIONS:
            wire.subscribe(f"{name}/{topic}", f"{SENSOR}JointState_", self._motion(topic))
        wire.subscribe(f"{name}/hold", f"{STD}Empty_", self._hear_hold)
        wire.subscribe(f"{name}/state_command", f"{CRTK}StringStamped_", self._hear_command)
        wire.subscribe(f"{name}/trajectory_j/set_ratio", f"{STD}Float64_", self._hear_ratio)
        own = f"emulator/{name}"
        self._asked = [
            session.declare_queryable(f"{own}/verdict", self._answer),
            session.declare_subscriber(f"{own}/request", self._request),
        ]

    def run(self, stopped: threading.Event) -> None:
        """Let time pass until stopped."""
        period_s, turn, before_s = 1 / (STATE_HZ * TURNS_PER_STATE), 0, monotonic_s()
        next_s = before_s
        while not stopped.wait(max(0.0, next_s - monotonic_s())):
            now_s = monotonic_s()
            with self._lock:
                busy = self._arm.is_busy
                if self._arm.step(now_s - before_s):
                    self._times["moved_ns"] = now_ns()
                arrived = busy and not self._arm.is_busy
            self._tell_state()
            if arrived:
                self._say("goal_reached", Bool(True))
            if turn % TURNS_PER_STATE == 0:
                self._tell_where()
            turn, before_s = turn + 1, now_s
            next_s = max(next_s + period_s, now_s)

    def verdict(self) -> dict[str, Any]:
        """The oracle's, and when the arm moved, was sent a set point, and was held last (ns since 1970; 0: never)."""
        with self._lock:
            told = self._oracle.verdict() | self._times | {"state": self._arm.state}
            told["position"], told["goal"] = self._arm.position.tolist(), self._arm.goal.tolist()
            return told | {"arrivals_s": self._arrivals[-20_000:], "holds_ns": self._holds_ns[-1000:]}

    def close(self) -> None:
        """Say nothing more."""
        for one in self._asked:
            one.undeclare()
        self._wire.close()

    def _motion(self, topic: str) -> Callable[[bytes], None]:
        name, moving = MOTIONS[topic]

        def hear(data: bytes) -> None:
            at_s, values = monotonic_s(), np.array(JointState.deserialize(data).position)
            with self._lock:
                arm = self._arm
                mixed = name == "jaw" and arm.moves and not moving
                now = Circumstances(arm.position, arm.takes_commands, self._held, moving, mixed)
                self._oracle.judge(name, values, at_s, now)
                self._times["set_point_ns"], self._held = now_ns(), False
                if name == "arm":
                    self._arrivals.append(at_s)
                arm.head(name, values, moving)

        return hear

    def _hear_hold(self, data: bytes) -> None:
        Empty.deserialize(data)
        with self._lock:
            self._arm.hold()
            self._times["held_ns"], self._held = now_ns(), True
            self._holds_ns.append(self._times["held_ns"])

    def _hear_command(self, data: bytes) -> None:
        with self._lock:
            self._arm.command(StringStamped.deserialize(data).string)

    def _hear_ratio(self, data: bytes) -> None:
        with self._lock:
            self._arm.slow_down(Float64.deserialize(data).data)

    def _request(self, sample: zenoh.Sample) -> None:
        word = sample.payload.to_string()
        with self._lock:
            if word == "fault":
                self._arm.fail()
            self._arm.stuck = {"stick": True, "loose": False}.get(word, self._arm.stuck)
            self._muted = {"mute": True, "speak": False}.get(word, self._muted)
        if word in ("fault", "error"):
            self._say("error", String(f"{self._name}: an error was asked for"))

    def _answer(self, query: zenoh.Query) -> None:
        query.reply(query.key_expr, json.dumps(self.verdict()))

    def _warn(self, text: str) -> None:
        self._say("warning", String(f"{self._name}: {text}"))

    def _tell_state(self) -> None:
        arm = self._arm
        told = arm.state, arm.is_homed, arm.is_busy
        if told != self._told:
            self._told = told
            self._say("operating_state", OperatingState(header(now_ns()), *told))

    def _tell_where(self) -> None:
        with self._lock:
            position, goal = self._arm.position.copy(), self._arm.goal.copy()
        at = header(now_ns())
        for topic, values, names in (
            ("measured_js", position[:6], JOINTS),
            ("setpoint_js", goal[:6], JOINTS),
            ("jaw/measured_js", position[6:], ["jaw"]),
            ("jaw/setpoint_js", goal[6:], ["jaw"]),
        ):
            if self._outlets[topic].wanted():
                none = [0.0] * len(names)
                self._say(topic, JointState(at, names, values.tolist(), none, none))
        for topic, joints in (("local/measured_cp", position), ("measured_cp", position), ("setpoint_cp", goal)):
            if self._outlets[topic].wanted():
                self._say(topic, PoseStamped(header(now_ns(), f"{self._name}_base"), _pose(joints[:6])))

    def _say(self, topic: str, message: Any) -> None:
        outlet = self._outlets[topic]
        if not self._muted and outlet.wanted():
            outlet.put(message.serialize(), now_ns())


def _pose(joints: np.ndarray) -> Pose:
    R, p = tool(joints)
    # Shepperd's choice: the largest of the four squares is divided by
    squares = np.array((np.trace(R), R[0, 0], R[1, 1], R[2, 2]))
    largest = int(np.argmax(squares))
    if largest == 0:
        q = np.array((1 + squares[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]))
    else:
        i, j, k = largest - 1, largest % 3, (largest + 1) % 3
        q = np.zeros(4)
        q[0], q[i + 1] = R[k, j] - R[j, k], 1 + R[i, i] - R[j, j] - R[k, k]
        q[j + 1], q[k + 1] = R[j, i] + R[i, j], R[k, i] + R[i, k]
    w, x, y, z = (float(value) for value in q / np.linalg.norm(q))
    return Pose(Point(*(float(value) for value in p)), Quaternion(x, y, z, w))
