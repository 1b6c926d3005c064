"""The computer of an emulated dVRK: one arm, its topics and the oracle; a console with two arms has two of these.

Joints and poses are taken both ways, at once (`servo_`) or by a trajectory in joint space (`move_`).
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.dvrk_emulator import poses
from agents.dvrk_emulator.arm import START, EmulatedArm
from agents.dvrk_emulator.geometry import JAW_LIMITS
from agents.dvrk_emulator.messages import (
    SECOND_NS,
    Bool,
    Empty,
    Float64,
    Header,
    JointState,
    Joy,
    OperatingState,
    PoseStamped,
    String,
    StringStamped,
    header,
)
from agents.dvrk_emulator.oracle import Circumstances, Oracle
from agents.dvrk_emulator.outlets import CLUTCH, CRTK, GEOMETRY, PEDALS, SENSOR, STD, TELEOPERATION, TOOL_TYPE, Outlets
from agents.dvrk_emulator.wire import Wire
from shared import clock

RESTS_NS, PRESSES_EVERY_S = 500_000_000, 2.0
STATE_HZ, TURNS_PER_STATE = 100.0, 2
KEPT = 20_000
STEP_M, DRIFT_RAD, NARROW_RAD = 0.005, 0.02, 0.01
JAW_BY_HAND_RAD = {"open_jaw": 0.7, "close_jaw": -0.4}
MOTIONS = {
    "servo_jp": ("arm", False),
    "move_jp": ("arm", True),
    "jaw/servo_jp": ("jaw", False),
    "jaw/move_jp": ("jaw", True),
}
POSES = {"servo_cp": False, "move_cp": True}


@dataclass(frozen=True)
class Behaviour:
    """How an emulated arm is, beside its geometry.

    Fields:
        ready: it begins enabled and homed.
        lag_s: how far behind a steady motion its joints come; 0 for none.
        start: its joints to begin with.
        foot: somebody stands at it, and presses the operator's pedal anew for each motion.
        jaw_stop_rad: where the fingers of its instrument touch.
        now_ns, monotonic_s: the clocks that it lives by.
    """

    ready: bool = False
    lag_s: float = 0.0
    start: tuple[float, ...] = START
    foot: bool = False
    jaw_stop_rad: float = JAW_LIMITS[0]
    now_ns: Callable[[], int] = clock.now_ns
    monotonic_s: Callable[[], float] = clock.monotonic_s


class EmulatedConsole:
    """One arm on a wire, from construction until `close`; `run` lets its time pass."""

    def __init__(self, wire: Wire, name: str, oracle: Oracle, behaviour: Behaviour) -> None:
        self.name, self._wire, self._oracle = name, wire, oracle
        self._now_ns, self._monotonic_s = behaviour.now_ns, behaviour.monotonic_s
        self._lock = threading.Lock()
        self._foot, self._foot_s = behaviour.foot, 0.0
        of_arm = behaviour.start, behaviour.lag_s, behaviour.jaw_stop_rad
        self._arm = EmulatedArm(behaviour.ready, self._warn, *of_arm)
        self._told: tuple[object, ...] = ()
        self._times = {"moved_ns": 0, "set_point_ns": 0, "held_ns": 0}
        self._holds_ns: list[int] = []
        self._arrivals: list[float] = []
        self._sent_ns: list[int] = []
        self._held, self._turns = True, 0
        self._moved_m = {"camera": 0.0, "setup": 0.0}
        self._outlets = Outlets(wire, name, self._now_ns)
        self._say("tool_type", String(TOOL_TYPE))
        self._say(TELEOPERATION, Bool(False))
        self._tell_state()
        for topic in MOTIONS:
            wire.subscribe(f"{name}/{topic}", f"{SENSOR}JointState_", self._motion(topic))
        for topic in POSES:
            wire.subscribe(f"{name}/{topic}", f"{GEOMETRY}PoseStamped_", self._pose(topic))
        wire.subscribe(f"{name}/hold", f"{STD}Empty_", self._hear_hold)
        wire.subscribe(f"{name}/state_command", f"{CRTK}StringStamped_", self._hear_command)
        wire.subscribe(f"{name}/trajectory_j/set_ratio", f"{STD}Float64_", self._hear_ratio)

    def run(self, stopped: threading.Event) -> None:
        """Let time pass until stopped."""
        period_s, before_s = 1 / (STATE_HZ * TURNS_PER_STATE), self._monotonic_s()
        next_s = before_s
        while not stopped.wait(max(0.0, next_s - self._monotonic_s())):
            now_s = self._monotonic_s()
            self.turn(now_s - before_s)
            before_s = now_s
            next_s = max(next_s + period_s, now_s)

    def turn(self, elapsed_s: float) -> None:
        """Let so much time pass at once; every second time it tells where it is."""
        with self._lock:
            busy = self._arm.is_busy
            if self._arm.step(elapsed_s):
                self._times["moved_ns"] = self._now_ns()
            arrived = busy and not self._arm.is_busy
        self._tell_state()
        if arrived:
            self._say("goal_reached", Bool(True))
        if self._turns % TURNS_PER_STATE == 0:
            self._tell_where()
        self._turns += 1
        if self._foot:
            self._press_anew()

    def _press_anew(self) -> None:
        """Whoever stands there lifts the foot after a motion and presses again, for the next one."""
        now_s = self._monotonic_s()
        rests = self._now_ns() - self._times["set_point_ns"] > RESTS_NS
        if rests and now_s - self._foot_s > PRESSES_EVERY_S:
            self._foot_s = now_s
            for word in ("pedal_up", "pedal"):
                self.request(word)

    def verdict(self) -> dict[str, Any]:
        """The oracle's, and when the arm moved, was sent a set point, and was held last (ns since 1970; 0: never)."""
        with self._lock:
            told = self._oracle.verdict() | self._times
            told |= {"state": self._arm.state, "is_homed": self._arm.is_homed}
            told["position"], told["goal"] = self._arm.position.tolist(), self._arm.goal.tolist()
            told |= {"arrivals_s": self._arrivals[-KEPT:], "sent_ns": self._sent_ns[-KEPT:]}
            return told | {"holds_ns": self._holds_ns[-1000:]}

    def place(self, joints: np.ndarray) -> None:
        """Have the arm stand at these joints, as if it had been carried there."""
        with self._lock:
            self._arm.position[:6] = joints
            self._arm.hold()
            self._held = True

    def request(self, word: str) -> None:
        """Have it do something.

        `fault`, `error`, `unreached` (a motion of its own has failed); `stick` and `loose`; `mute` and `speak`;
        `camera` and `setup` (endoscope and set-up joints move by STEP_M, `camera_back` and `setup_back` back again);
        `clutch` and `unclutch` (that pedal); `pedal` and `pedal_up` (the operator is there); `teleop`, `no_teleop`;
        `drift` (somebody at the console moves it by DRIFT_RAD, and tells nobody); `narrow` and `wide` (the jaw opens
        and closes by NARROW_RAD alone, or as built); `open_jaw` and `close_jaw` (somebody at the console does).
        """
        with self._lock:
            if word == "fault":
                self._arm.fail()
            self._arm.stuck = {"stick": True, "loose": False}.get(word, self._arm.stuck)
            self._outlets.muted = {"mute": True, "speak": False}.get(word, self._outlets.muted)
            if word == "drift":
                self._arm.drift(DRIFT_RAD)
            if word in JAW_BY_HAND_RAD:
                self._arm.jaw_by_hand(JAW_BY_HAND_RAD[word])
            if word in ("narrow", "wide"):
                self._arm.narrow(NARROW_RAD if word == "narrow" else np.inf)
            what, _, back = word.partition("_")
            if what in self._moved_m:
                self._moved_m[what] = 0.0 if back else STEP_M
        if word in ("fault", "error"):
            self._say("error", String(f"{self.name}: an error was asked for"))
        if word == "unreached":
            self._say("goal_reached", Bool(False))
        if word in ("teleop", "no_teleop"):
            self._say(TELEOPERATION, Bool(word == "teleop"))
        if word in ("clutch", "unclutch"):
            self._say(CLUTCH, Joy(header(self._now_ns()), [], [int(word == "clutch")]))
        if word in ("pedal", "pedal_up"):
            for pedal in PEDALS:
                self._say(pedal, Joy(header(self._now_ns()), [], [int(word == "pedal")]))

    def close(self) -> None:
        """Say nothing more."""
        self._wire.close()

    def _motion(self, topic: str) -> Callable[[bytes], None]:
        name, moving = MOTIONS[topic]

        def hear(data: bytes) -> None:
            said = JointState.deserialize(data)
            self._head(name, np.array(said.position), moving, said.header)

        return hear

    def _pose(self, topic: str) -> Callable[[bytes], None]:
        def hear(data: bytes) -> None:
            said = PoseStamped.deserialize(data)
            R, pin = poses.read(said.pose)
            self._head("arm", poses.joints_at(R, pin, self._arm.goal[:6]), POSES[topic], said.header)

        return hear

    def _head(self, name: str, values: np.ndarray, moving: bool, said: Header) -> None:
        at_s = self._monotonic_s()
        with self._lock:
            arm = self._arm
            mixed = name == "jaw" and arm.moves and not moving
            now = Circumstances(arm.position, arm.takes_commands, self._held, moving, mixed)
            self._oracle.judge(name, values, at_s, now)
            self._times["set_point_ns"], self._held = self._now_ns(), False
            if name == "arm":
                self._arrivals.append(at_s)
                self._sent_ns.append(said.stamp.sec * SECOND_NS + said.stamp.nanosec)
            arm.head(name, values, moving)

    def _hear_hold(self, data: bytes) -> None:
        Empty.deserialize(data)
        with self._lock:
            cut_short = self._arm.moves
            self._arm.hold()
            self._times["held_ns"], self._held = self._now_ns(), True
            self._holds_ns.append(self._times["held_ns"])
        if cut_short:
            self._say("goal_reached", Bool(False))

    def _hear_command(self, data: bytes) -> None:
        with self._lock:
            self._arm.command(StringStamped.deserialize(data).string)

    def _hear_ratio(self, data: bytes) -> None:
        with self._lock:
            self._arm.slow_down(Float64.deserialize(data).data)

    def _warn(self, text: str) -> None:
        self._say("warning", String(f"{self.name}: {text}"))

    def _tell_state(self) -> None:
        arm = self._arm
        told = arm.state, arm.is_homed, arm.is_busy
        if told != self._told:
            self._told = told
            self._say("operating_state", OperatingState(header(self._now_ns()), *told))

    def _tell_where(self) -> None:
        with self._lock:
            # a process that stalls after this tells late, and of the time when it was so
            at_ns, position, goal = self._now_ns(), self._arm.position.copy(), self._arm.goal.copy()
            effort = self._arm.jaw_effort
        self._outlets.tell_where(at_ns, position, goal, effort, self._moved_m)

    def _say(self, topic: str, message: Any) -> None:
        self._outlets.say(topic, message)
