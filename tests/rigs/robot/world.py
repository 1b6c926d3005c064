"""A robot bridge, a guard and an emulated console in one process, in a time that goes on when it is told to.

What they say to each other arrives as bytes and at once. A guard that passes everything (`guarded=False`) shows what
the bridge does alone.
"""

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np

from agents.configuration.sections import DvrkSection
from agents.dvrk_emulator.arm import start_of
from agents.dvrk_emulator.console import Behaviour, EmulatedConsole
from agents.dvrk_emulator.geometry import JAW_LIMITS
from agents.dvrk_emulator.oracle import Field, Oracle
from agents.dvrk_emulator.wire import Outlet
from agents.guard import cdr
from agents.guard.description import Description
from agents.guard.monitor import SETTLES_NS, Action, Kind, Monitor
from agents.launch.guard_process import description_of
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.dvrk.psm import DvrkPsm
from agents.robot_bridge.limits import MotionLimits
from schemas.messages import (
    Arm,
    ChallengeEcho,
    CommandAnswer,
    CommandHeader,
    ExecutionEvent,
    FrameNotice,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    Outcome,
    RobotState,
)
from schemas.topics import ARM, EXECUTION, FRAME_NOTICE, HEARTBEAT, PLAN, ROBOT_STATE, Topic
from shared.calibration.jaw.file import JawZero
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.ros import guarded as between
from shared.ros.guarded import GuardedError, SetPoint, key_of
from shared.ros.link import Heard, Said
from shared.ros.naming import Ros2dds
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.session import SessionSettings

NAME, TOOL, RIG_ARM = "PSM1", "LARGE_NEEDLE_DRIVER:400006", "psm1"
HZ = 200.0
TICK_NS = round(1e9 / HZ)
BEAT_NS = 50_000_000
EPOCH_NS, SECOND_NS = 1_700_000_000_000_000_000, 10**9
LONG_NS = 600 * SECOND_NS


class Topics:
    """What is said on a topic is heard at once by all but who said it; what is latched also by who comes later."""

    def __init__(self) -> None:
        self._console: dict[str, list[Callable[[bytes], None]]] = {}
        self._bridge: dict[str, list[Heard]] = {}
        self._latched: dict[str, bytes] = {}
        self._now_ns: Callable[[], int] = lambda: EPOCH_NS
        self.owner_changed: Callable[[str, bool], None] = lambda _token, _comes: None
        self.guards: list[WorldGuard] = []
        # how the bridge and the robot's computer reach each other: at once, unless somebody has it otherwise
        self.later: Callable[[Callable[[], None]], None] = lambda deliver: deliver()

    def publish(self, topic: str, kind: str, latched: bool) -> Outlet:
        """A topic for the console to speak on."""

        def put(data: bytes, _now_ns: int) -> None:
            if latched:
                self._latched[topic] = data
            self.later(lambda: self.tell_bridge(topic, data))
            self.tell_guard(topic, data)

        # a console publishes only while somebody subscribes, but for what it keeps for who comes later
        return Outlet(lambda: latched or topic in self._bridge, put)

    def subscribe(self, topic: str, kind: str, receive: Callable[[bytes], None]) -> None:
        self._console.setdefault(topic, []).append(receive)

    def close(self) -> None:
        self._console, self._bridge = {}, {}

    def tell_guard(self, topic: str, data: bytes) -> None:
        for guard in self.guards:
            guard.hear(topic, data)

    def tell_bridge(self, topic: str, data: bytes) -> None:
        """Have the bridge hear something, whoever said it."""
        for heard in self._bridge.get(topic, ()):
            heard.receive(data, self._now_ns())

    def tell_console(self, topic: str, data: bytes) -> None:
        for receive in self._console.get(topic, ()):
            receive(data)

    def link(self, now_ns: Callable[[], int]) -> Callable[..., "Link"]:
        """What makes the bridge's end, as it makes a RosLink."""
        self._now_ns = now_ns
        return lambda *arguments: Link(self, *arguments)

    def attend(self, heard: tuple[Heard, ...], owner_changed: Callable[[str, bool], None]) -> None:
        self.owner_changed = owner_changed
        for one in heard:
            self._bridge.setdefault(one.topic, []).append(one)
            if one.latched and one.topic in self._latched:
                one.receive(self._latched[one.topic], self._now_ns())


class Link:
    """The bridge's end of the topics, in place of a RosLink."""

    failed, broken = "", 0

    def __init__(
        self,
        topics: Topics,
        settings: SessionSettings,
        naming: Any,
        heard: tuple[Heard, ...],
        said: tuple[Said, ...],
        watched: tuple[str, ...],
        owner_changed: Callable[[str, bool], None],
    ) -> None:
        self._topics, self._heard, self._owner_changed = topics, heard, owner_changed
        self._said, self._open = {one.topic for one in said}, False

    def open(self) -> None:
        if not self._open:
            self._open = True
            self._topics.attend(self._heard, self._owner_changed)

    def say(self, topic: str, payload: bytes) -> bool:
        """Have the console, or the guard, hear it."""
        if not self._open or topic not in self._said:
            return False
        self._topics.later(lambda: self._arrive(topic, payload))
        return True

    def _arrive(self, topic: str, payload: bytes) -> None:
        self._topics.tell_guard(topic, payload)
        self._topics.tell_console(topic, payload)

    def close(self) -> None:
        self._open = False


class WorldGuard:
    """The guard between bridge and console; `actions` is what it did beside passing set points on."""

    def __init__(self, arm: str, topics: Topics, now_ns: Callable[[], int], judges: bool, limits: MotionLimits) -> None:
        """Of a bridge with these limits, it lets axes go as fast as they can where those are brisker than a rig's."""
        self._name, self._topics, self._now_ns, self._judges = arm.upper(), topics, now_ns, judges
        document: dict[str, Any] = {
            **description_of(arm, DvrkSection(endpoint="tcp/127.0.0.1:1", arm=self._name)),
            "rate_hz": HZ,
        }
        if limits.joint_speeds is None:
            speeds = (*LARGE_NEEDLE_DRIVER.max_speeds.tolist(), LARGE_NEEDLE_DRIVER.jaw_max_speed)
            axes: list[list[float]] = document["axes"]
            document["axes"] = [[*axis[:2], speed] for axis, speed in zip(axes, speeds, strict=True)]
        self.monitor, self.actions = Monitor(Description.from_document(document)), list[Action]()
        # it has been there for a while
        self.monitor.challenge(now_ns() - SETTLES_NS - 1)

    def hear(self, topic: str, data: bytes) -> None:
        now_ns = self._now_ns()
        hears: dict[str, Callable[[], list[Action] | None]] = {
            key_of(self._name, between.SET_POINT): lambda: self._set_point(between.set_point_from(topic, data), now_ns),
            key_of(self._name, between.ALIVE): lambda: self.monitor.hear_alive(between.alive_from(topic, data), now_ns),
            f"{self._name}/measured_js": lambda: self.monitor.hear_joints(cdr.joint_positions(data), now_ns),
            f"{self._name}/jaw/measured_js": lambda: self.monitor.hear_jaw(cdr.joint_positions(data), now_ns),
            f"{self._name}/hold": lambda: self.monitor.hear_hold(now_ns),
        }
        if topic in hears:
            with contextlib.suppress(cdr.CdrError, GuardedError):
                self.do(hears[topic]() or [])

    def turn(self) -> None:
        """One turn, and a challenge for the bridge."""
        now_ns = self._now_ns()
        self.do(self.monitor.turn(now_ns) if self._judges else [])
        name = key_of(self._name, between.CHALLENGE)
        told = between.challenge_bytes(name, self.monitor.challenge(now_ns))
        self._topics.later(lambda: self._topics.tell_bridge(name, told))

    def do(self, actions: list[Action]) -> None:
        """Pass on, hold or pause."""
        for action in actions:
            now_ns = self._now_ns()
            if action.kind is Kind.PASS:
                self._tell("servo_jp", cdr.joint_state(action.positions[:-1], now_ns))
                self._tell("jaw/servo_jp", cdr.joint_state(action.positions[-1:], now_ns))
                continue
            self.actions.append(action)
            if action.kind is Kind.HOLD:
                self._tell("hold", cdr.EMPTY)
            else:
                self._tell("state_command", cdr.string_stamped("pause", now_ns))

    def _tell(self, topic: str, data: bytes) -> None:
        self._topics.tell_console(f"{self._name}/{topic}", data)
        self._topics.later(lambda: self._topics.tell_bridge(f"{self._name}/{topic}", data))

    def _set_point(self, said: SetPoint, now_ns: int) -> list[Action]:
        judged = self.monitor.hear_set_point(said, now_ns)
        return judged if self._judges else [Action(Kind.PASS, said.positions)]


class World:
    """Bridge, guard, console, oracle, and somebody who may stand by.

    Fields:
        stands_by: heartbeats come, each of the arming that was accepted last, and each an answer.
        sees: the camera gives frames, which echo the newest challenge.
        state: the newest of the bridge.
        faults: how often a step of the bridge failed.
    """

    def __init__(
        self,
        limits: MotionLimits,
        lag_s: float,
        arm: str = RIG_ARM,
        topics: Topics | None = None,
        guarded: bool = True,
        jaw_stop_rad: float = JAW_LIMITS[0],
        jaw_zero: JawZero | None = None,
    ) -> None:
        """One arm of a rig; arms that share their topics are those of one console.

        The fingers of its instrument touch at `jaw_stop_rad`, and the bridge is told of it by `jaw_zero`.
        """
        self.now_ns, self.stands_by, self.faults = EPOCH_NS, False, 0
        self.topics, self._arm, name, base = topics or Topics(), arm, arm.upper(), SIMULATED_BASES[arm]
        self.oracle = Oracle(Field(base), hears_heartbeats=True)
        behaviour = Behaviour(
            True,
            lag_s,
            start_of(name),
            jaw_stop_rad=jaw_stop_rad,
            now_ns=lambda: self.now_ns,
            monotonic_s=lambda: self.now_ns * 1e-9,
        )
        self.console = EmulatedConsole(self.topics, name, self.oracle, behaviour)
        self.backend = DvrkPsm(
            name,
            SessionSettings(),
            Ros2dds(),
            TOOL,
            dry_run=False,
            has_no=("teleoperation", "endoscope_arm", "clutch"),
            linked=self.topics.link(lambda: self.now_ns),
            clock=lambda: self.now_ns,
            monotonic=lambda: self.now_ns,
        )
        self.guard = WorldGuard(arm, self.topics, lambda: self.now_ns, guarded, limits)
        self.topics.guards.append(self.guard)
        of_camera: dict[str, Any] = {"calibration_id": "c", "registered_ns": EPOCH_NS, "tissue_needed": False}
        config = RobotBridgeConfig(arm, base, tick_hz=HZ, limits=limits, jaw_zero=jaw_zero, **of_camera)
        self.bridge = RobotBridge(config, self.backend)
        self.armings, self.plan_id, self.arming_id, self._beat_ns = 0, "", "", 0
        self.events: list[ExecutionEvent] = []
        self.state: RobotState | None = None
        self.sees = True
        # the bridge has been there for longer than any plan of these tests is old
        self.step(Tick(EPOCH_NS - LONG_NS))
        self.tick(20)

    @property
    def moves(self) -> bool:
        """Whether a plan is being carried out."""
        return bool(self.bridge.executes)

    def tick(self, count: int = 1, elapsed_ns: int = TICK_NS) -> None:
        """Let time pass, for the console as well."""
        for _ in range(count):
            self.now_ns += elapsed_ns
            self.console.turn(max(elapsed_ns, 0) * 1e-9)
            self.guard.turn()
            if self.sees:
                self.see()
            if self.stands_by and self.arming_id and self.now_ns - self._beat_ns >= BEAT_NS:
                self._beat_ns = self.now_ns
                self.oracle.heartbeat(self.now_ns * 1e-9)
                self.beat(self.answer())
            self.step(Tick(self.now_ns))

    def see(self) -> None:
        self.step(Received(FRAME_NOTICE, "", 0, FrameNotice(self.stamp())))

    def stamp(self, captured_ns: int | None = None) -> FrameStamp:
        """Of a frame that is taken now, or was then, and echoes what was newest."""
        at_ns = self.now_ns if captured_ns is None else captured_ns
        echo_ns = min(at_ns, 0 if self.state is None else self.state.challenge_ns)
        return FrameStamp(1, at_ns, at_ns, "c", (ChallengeEcho(self._arm, max(1, echo_ns)),))

    def answer(self) -> Heartbeat:
        """The heartbeat of a person who presses the button and has seen the newest challenge."""
        of = (self.state.challenge_ns, self.state.guard_challenge) if self.state else (0, 0)
        # whom nobody armed says so of an arming that is none
        return Heartbeat(self._arm, self.plan_id, self.now_ns, self.arming_id or "none", *of, pressed=True)

    def beat(self, heartbeat: Heartbeat) -> None:
        """Have bridge and guard hear a heartbeat, whatever it says."""
        said = heartbeat.arm, heartbeat.arming_id, heartbeat.guard_challenge, heartbeat.pressed
        self.guard.monitor.hear_heartbeat(*said, self.now_ns)
        self.step(Received(HEARTBEAT, "", 0, heartbeat))

    def publish(self, plan: GraspPlan) -> None:
        self.step(Received(PLAN, "", 0, plan))

    def arm(self, plan_id: str, arm: str = "", instance: str = "") -> CommandAnswer | None:
        """Arm a plan, under another arm's name where one is given; None where the step failed."""
        self.armings += 1
        header = CommandHeader(f"arming-{self.armings}", self.now_ns + 10**9, "ann")
        echo_ns = self.state.challenge_ns if self.state else 0
        answer = self.command(ARM, Arm(header, arm or self._arm, plan_id, echo_ns, pressed=True), instance)
        if answer is not None and answer.outcome is Outcome.ACCEPTED:
            self.plan_id, self.arming_id, self._beat_ns = plan_id, header.id, 0
        return answer

    def command(self, topic: Topic, message: Any, instance: str = "") -> CommandAnswer | None:
        """A command of an operator and its answer; None where the step failed."""
        said = self.step(Command(topic, instance or self._arm, message, self.now_ns))
        return next((one for one in said if isinstance(one, CommandAnswer)), None)

    def step(self, arrived: Received | Tick | Command) -> list[Output | CommandAnswer]:
        """One step of the bridge; one that fails is counted, and nothing follows from it, as its runner has it."""
        try:
            said = list(self.bridge.step(arrived))
        except Exception:
            self.faults += 1
            return []
        states = [o.message for o in said if isinstance(o, Output) and o.topic is ROBOT_STATE]
        self.state = states[-1] if states else self.state
        self.events += [o.message for o in said if isinstance(o, Output) and o.topic is EXECUTION]
        return said

    def put(self, joints: np.ndarray) -> None:
        """Have the arm stand somewhere else at once, as if it had been carried there."""
        self.console.place(joints)
        self.tick(4)
