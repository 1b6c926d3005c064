"""A bridge that a test feeds by hand, the plan that it is armed with, and an arm that tells what a test has it tell."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.backend import ArmState
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import (
    Arm,
    ChallengeEcho,
    CommandAnswer,
    CommandHeader,
    ExecutionEvent,
    ExecutionKind,
    FrameNotice,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    Hold,
    Outcome,
    Phase,
    Policy,
    RectifiedStereo,
    RobotMode,
    RobotState,
    Status,
    TissueSurface,
    Waypoint,
)
from schemas.topics import ARM, EXECUTION, FRAME_NOTICE, HEARTBEAT, HOLD, PLAN, ROBOT_STATE, SURFACE
from shared.rigid_transforms import exp_so3, transform
from shared.runtime.agent import Command, Output, Received, Tick

SECOND, TICK = 10**9, 10**7
EPOCH = 1_700_000_000 * SECOND
BEAT_TICKS = 5
"""Heartbeats and frames come at 20 Hz."""


def waypoint(place_mm: Sequence[float], jaw_rad: float, phase: Phase, roll: float = 0.3) -> Waypoint:
    T = transform(exp_so3(np.array((0.1, 0, roll))), np.array(place_mm, float) / 1e3)
    return Waypoint(T, jaw_rad, phase, None)


WAYPOINTS = (
    waypoint((15, 5, 60), 1.0, Phase.APPROACH),
    waypoint((15, 5, 75), 1.0, Phase.APPROACH),
    waypoint((15, 5, 75), 0.3, Phase.CAPTURE),
    waypoint((18, 5.5, 75), 0.3, Phase.SLIDE, 0.4),
    waypoint((20, 6, 75), 0.3, Phase.SLIDE, 0.5),
    waypoint((20, 6, 75), -0.2, Phase.GRASP, 0.5),
    waypoint((20, 6, 65), -0.2, Phase.RETREAT, 0.5),
)
"""A whole grasp, of seven seconds at full speed, five of them in contact with thread."""
SHORT_GRASP = (
    waypoint((30, 8, 72), 1.0, Phase.APPROACH),
    waypoint((30, 8, 75), 0.3, Phase.CAPTURE),
    waypoint((31, 8, 75), 0.3, Phase.SLIDE, 0.4),
    waypoint((32, 8.5, 75), 0.3, Phase.SLIDE, 0.5),
    waypoint((32, 8.5, 75), -0.2, Phase.GRASP, 0.5),
)
"""Of what a console is sent while a test waits for it."""


def plan(plan_id: str = "p1", arm: str = "psm1", captured_ns: int = EPOCH, **changes: Any) -> GraspPlan:
    values: dict[str, Any] = {
        "stamp": FrameStamp(1, captured_ns, captured_ns, "c"),
        "status": Status.OK,
        "reason": "",
        "waypoints": WAYPOINTS,
        "policy": Policy.CAPTURE_SLIDE_GRASP,
        "s_goal": 0.5,
        "s_capture": 0.4,
        "probability": 0.9,
        "slide_m": 0.005,
        "alternatives": (),
    }
    return GraspPlan(plan_id=plan_id, arm=arm, goal_id="g", **(values | changes))


def rejected(plan_id: str = "p1", **changes: Any) -> GraspPlan:
    return plan(plan_id, status=Status.FAILED, reason="the goal is not on the thread", waypoints=(), **changes)


class UnreliableArm(SimulatedPsm):
    """A simulated arm that tells of itself what `tells` makes of the truth."""

    tells: Callable[[ArmState], ArmState] = staticmethod(lambda state: state)

    def state(self, now_ns: int) -> ArmState:
        return self.tells(super().state(now_ns))

    def tell(self, **changes: Any) -> None:
        """From now on, whatever is true."""
        self.tells = lambda state: dataclasses.replace(state, **changes)


class RealArm(UnreliableArm):
    """Behaves as a simulated arm, and is owed what a real one is."""

    is_real, accepts_replayed_time = True, False


class Drive:
    """A bridge that is fed by hand, with all states and events that it ever told.

    Fields:
        camera: frames are told of with each heartbeat, and echo the challenge of so many states ago; None: none are.
    """

    def __init__(
        self,
        config: RobotBridgeConfig | None = None,
        backend: Any = None,
        make: Callable[[RobotBridgeConfig, Any], Any] = RobotBridge,
        camera: int | None = None,
        ticked: bool = True,
    ) -> None:
        self.backend: Any = backend or UnreliableArm()
        self.bridge = make(config or RobotBridgeConfig(), self.backend)
        self.now_ns, self.camera = EPOCH, camera
        self.armings, self.arming_id = 0, "none"
        self.states, self.events = list[RobotState](), list[ExecutionEvent]()
        if ticked:
            self.tick(0)
            self.see()

    def feed(self, arrived: Received | Tick | Command) -> list[Any]:
        said = []
        for one in self.bridge.step(arrived):
            said.append(one)
            if isinstance(one, Output):
                {ROBOT_STATE: self.states, EXECUTION: self.events}[one.topic].append(one.message)
        return said

    def hear(self, topic: Any, *messages: Any) -> None:
        for message in messages:
            self.feed(Received(topic, "", 0, message))

    def publish(self, *plans: GraspPlan) -> None:
        self.hear(PLAN, *plans)

    def tick(self, elapsed_ns: int = TICK) -> None:
        """One turn."""
        self.now_ns += elapsed_ns
        self.feed(Tick(self.now_ns))

    def state(self, elapsed_ns: int = TICK) -> RobotState:
        """One turn; the state that was told in it."""
        told = len(self.states)
        self.tick(elapsed_ns)
        assert len(self.states) == told + 1
        return self.states[-1]

    def stamp(self, late: int = 0) -> FrameStamp:
        """Of a frame that is taken now, and echoes the challenge of so many states ago."""
        echo = ChallengeEcho("psm1", self.states[-1 - late].challenge_ns)
        return FrameStamp(1, self.now_ns, self.now_ns, "c", (echo,))

    def see(self) -> None:
        if self.camera is not None and len(self.states) > self.camera:
            self.hear(FRAME_NOTICE, FrameNotice(self.stamp(self.camera)))

    def beat(
        self,
        plan_id: str = "p1",
        arm: str = "psm1",
        at_ns: int | None = None,
        arming_id: str | None = None,
        echo_ns: int | None = None,
        pressed: bool = False,
    ) -> None:
        """A heartbeat that answers the newest challenge, or `echo_ns`; with `at_ns` none, as before there were any."""
        newest_ns = self.states[-1].challenge_ns if at_ns is None else 0
        sent_ns, echoes_ns = self.now_ns if at_ns is None else at_ns, newest_ns if echo_ns is None else echo_ns
        of = arming_id or self.arming_id
        self.hear(HEARTBEAT, Heartbeat(arm, plan_id, sent_ns, of, echoes_ns, pressed=pressed))

    def arm(self, plan_id: str = "p1", arm: str = "psm1", instance: str = "psm1", **how: Any) -> CommandAnswer:
        """Arm a plan; a refusal is an event as well."""
        self.armings += 1
        header = CommandHeader(f"arming-{self.armings}", self.now_ns + SECOND, "ann")
        heard_ns = self.states[-1].challenge_ns if self.states else 0
        answer, event = self.feed(Command(ARM, instance, Arm(header, arm, plan_id, heard_ns, **how), self.now_ns))
        assert (event.message.code, event.message.reason) == (answer.code, answer.reason)
        if answer.outcome is Outcome.ACCEPTED:
            self.arming_id = header.id
        return answer

    def armed(self, *plans: GraspPlan, **how: Any) -> "Drive":
        """With a plan of a frame that is taken now, or these."""
        self.publish(*(plans or (plan(stamp=self.stamp()),)))
        answer = self.arm(**how)
        assert answer.outcome is Outcome.ACCEPTED, answer
        return self

    def refused(self, **command: str) -> tuple[str, str]:
        """The code and the reason of a refused arming, after which nothing moves."""
        answer = self.arm(**command)
        assert answer.outcome is Outcome.REFUSED
        assert stands_still(self, 3)
        return answer.code, answer.reason

    def hold(self, arm: str = "psm1") -> CommandAnswer:
        header = CommandHeader("h", self.now_ns + SECOND, "ann")
        return self.feed(Command(HOLD, "psm1", Hold(header, arm), self.now_ns))[0]

    def run(self, ticks: int, pressed: bool = False) -> "Drive":
        """Go on with heartbeats and frames until the motion ends, or that many turns are over."""
        for index in range(ticks):
            if index % BEAT_TICKS == 0:
                self.see()
                self.beat(pressed=pressed)
            self.tick()
            if not self.bridge.executes:
                break
        return self

    @property
    def ended(self) -> tuple[ExecutionKind, str]:
        """Kind and code of the last event."""
        return self.events[-1].kind, self.events[-1].code


def moving(ticks: int = 100) -> Drive:
    """In the midst of plan p1."""
    drive = Drive().armed(plan()).run(ticks)
    assert drive.states[-1].mode is RobotMode.MOVING
    return drive


def stands_still(drive: Drive, ticks: int = 25) -> bool:
    """Whether the arm rests from now on, heartbeats or not."""
    before = drive.state()
    for _ in range(ticks):
        drive.beat()
        after = drive.state()
        if not np.array_equal(before.joints, after.joints) or before.jaw_rad != after.jaw_rad:
            return False
    return True


def tissue(at_ns: int, depth_m: float, calibration_id: str = "c") -> TissueSurface:
    """Flat tissue all over the image."""
    camera = RectifiedStereo(640, 480, 600.0, 600.0, 320.0, 240.0, 0.005, 1.0)
    u_px, v_px = np.arange(5.0, 640, 10), np.arange(5.0, 480, 10)
    depth = np.full((len(v_px), len(u_px)), depth_m)
    stamp = FrameStamp(1, at_ns, at_ns, calibration_id)
    return TissueSurface(stamp, camera, u_px, v_px, depth, depth > 0, 1e-3 * depth)


def tissue_before(drive: Drive, depth_m: float, calibration_id: str = "c") -> None:
    """Tell of tissue that is measured now."""
    drive.hear(SURFACE, tissue(drive.now_ns, depth_m, calibration_id))
