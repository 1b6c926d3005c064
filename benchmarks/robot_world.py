"""A robot bridge and an emulated console in one process and in a time of their own: everything but the network.

What the bridge says reaches the console as bytes and at once, and the other way round; both live by a clock that goes
on when it is told to, so that ten thousand motions take minutes and are the same each time.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from agents.emulator.arm import start_of
from agents.emulator.console import Behaviour, EmulatedConsole
from agents.emulator.oracle import Field, Oracle
from agents.emulator.wire import Outlet
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.dvrk.psm import DvrkPsm
from agents.robot_bridge.limits import MotionLimits
from schemas.messages import (
    Arm,
    CommandAnswer,
    CommandHeader,
    ExecutionEvent,
    GraspPlan,
    Heartbeat,
    Outcome,
)
from schemas.topics import ARM, EXECUTION, HEARTBEAT, PLAN, Topic
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.ros.link import Heard, Said
from shared.ros.naming import Ros2dds
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.session import SessionSettings

NAME, TOOL, RIG_ARM = "PSM1", "LARGE_NEEDLE_DRIVER:400006", "psm1"
HZ = 200.0
TICK_NS = round(1e9 / HZ)
BEAT_NS = 50_000_000
EPOCH_NS, SECOND_NS = 1_700_000_000_000_000_000, 10**9


class Topics:
    """What is said on a topic is heard at once by all but who said it; what is latched also by who comes later."""

    def __init__(self) -> None:
        self._console: dict[str, list[Callable[[bytes], None]]] = {}
        self._bridge: dict[str, list[Heard]] = {}
        self._latched: dict[str, bytes] = {}
        self._now_ns: Callable[[], int] = lambda: EPOCH_NS
        self.owner_changed: Callable[[str, bool], None] = lambda _token, _comes: None

    def publish(self, topic: str, kind: str, latched: bool) -> Outlet:  # noqa: ARG002
        """A topic for the console to speak on."""

        def put(data: bytes, _now_ns: int) -> None:
            if latched:
                self._latched[topic] = data
            self.tell_bridge(topic, data)

        # a console publishes only while somebody subscribes, but for what it keeps for who comes later
        return Outlet(lambda: latched or topic in self._bridge, put)

    def subscribe(self, topic: str, kind: str, receive: Callable[[bytes], None]) -> None:  # noqa: ARG002
        """A topic for the console to hear."""
        self._console.setdefault(topic, []).append(receive)

    def close(self) -> None:
        """Nothing is heard any more."""
        self._console, self._bridge = {}, {}

    def tell_bridge(self, topic: str, data: bytes) -> None:
        """Have the bridge hear something, whoever said it."""
        for heard in self._bridge.get(topic, ()):
            heard.receive(data, self._now_ns())

    def tell_console(self, topic: str, data: bytes) -> None:
        """Have the console hear something."""
        for receive in self._console.get(topic, ()):
            receive(data)

    def link(self, now_ns: Callable[[], int]) -> Callable[..., "Link"]:
        """What makes the bridge's end, as it makes a RosLink."""
        self._now_ns = now_ns
        return lambda *arguments: Link(self, *arguments)

    def attend(self, heard: tuple[Heard, ...], owner_changed: Callable[[str, bool], None]) -> None:
        """Have the bridge hear topics."""
        self.owner_changed = owner_changed
        for one in heard:
            self._bridge.setdefault(one.topic, []).append(one)
            if one.latched and one.topic in self._latched:
                one.receive(self._latched[one.topic], self._now_ns())


class Link:
    """The bridge's end of the topics, in place of a RosLink."""

    failed = ""

    def __init__(
        self,
        topics: Topics,
        settings: SessionSettings,  # noqa: ARG002
        naming: Any,  # noqa: ARG002
        heard: tuple[Heard, ...],
        said: tuple[Said, ...],
        watched: tuple[str, ...],  # noqa: ARG002
        owner_changed: Callable[[str, bool], None],
    ) -> None:
        self._topics, self._heard, self._owner_changed = topics, heard, owner_changed
        self._said, self._open = {one.topic for one in said}, False

    def open(self) -> None:
        """Begin to hear."""
        if not self._open:
            self._open = True
            self._topics.attend(self._heard, self._owner_changed)

    def say(self, topic: str, payload: bytes) -> None:
        """Have the console hear it."""
        if self._open and topic in self._said:
            self._topics.tell_console(topic, payload)

    def close(self) -> None:
        """Say nothing more."""
        self._open = False


class World:
    """Bridge, console, oracle, and somebody who may stand by.

    Fields:
        stands_by: heartbeats come, each of the arming that was accepted last.
        faults: how often a step of the bridge failed.
    """

    def __init__(self, limits: MotionLimits, lag_s: float, arm: str = RIG_ARM, topics: Topics | None = None) -> None:
        """One arm of a rig; arms that share their topics are those of one console."""
        self.now_ns, self.stands_by, self.faults = EPOCH_NS, False, 0
        self.topics, self._arm, name, base = topics or Topics(), arm, arm.upper(), SIMULATED_BASES[arm]
        self.oracle = Oracle(Field(base), hears_heartbeats=True)
        behaviour = Behaviour(
            True, lag_s, start_of(name), now_ns=lambda: self.now_ns, monotonic_s=lambda: self.now_ns * 1e-9
        )
        self.console = EmulatedConsole(self.topics, name, self.oracle, behaviour)
        self.backend = DvrkPsm(
            name,
            SessionSettings(),
            Ros2dds(),
            TOOL,
            dry_run=False,
            linked=self.topics.link(lambda: self.now_ns),
            clock=lambda: self.now_ns,
        )
        self.bridge = RobotBridge(RobotBridgeConfig(arm, base, tick_hz=HZ, limits=limits), self.backend)
        self.armings, self.plan_id, self.arming_id, self._beat_ns = 0, "", "", 0
        self.events: list[ExecutionEvent] = []
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
            if self.stands_by and self.arming_id and self.now_ns - self._beat_ns >= BEAT_NS:
                self._beat_ns = self.now_ns
                self.oracle.heartbeat(self.now_ns * 1e-9)
                self.beat(Heartbeat(self._arm, self.plan_id, self.now_ns, self.arming_id))
            self.step(Tick(self.now_ns))

    def beat(self, heartbeat: Heartbeat) -> None:
        """Have the bridge hear a heartbeat, whatever it says."""
        self.step(Received(HEARTBEAT, "", 0, heartbeat))

    def publish(self, plan: GraspPlan) -> None:
        """Have the bridge hear a plan."""
        self.step(Received(PLAN, "", 0, plan))

    def arm(self, plan_id: str, arm: str = "", instance: str = "") -> CommandAnswer | None:
        """Arm a plan, under another arm's name where one is given; None where the step failed."""
        self.armings += 1
        header = CommandHeader(f"arming-{self.armings}", self.now_ns + 10**9, "ann")
        answer = self.command(ARM, Arm(header, arm or self._arm, plan_id), instance)
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
        self.events += [o.message for o in said if isinstance(o, Output) and o.topic is EXECUTION]
        return said

    def put(self, joints: np.ndarray) -> None:
        """Have the arm stand somewhere else at once, as if it had been carried there."""
        self.console.place(joints)
        self.tick(4)
