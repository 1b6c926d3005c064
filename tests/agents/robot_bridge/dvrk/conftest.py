"""A bridge with a real backend, a guard and an emulated console behind a real router, and somebody who stands by."""

import contextlib
import threading
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
import zenoh

from agents.cli.rig.config import RigConfig
from agents.cli.rig.sections import ArmSection, DvrkSection
from agents.cli.running.guard import document_of
from agents.emulator.asked import answering
from agents.emulator.console import Behaviour, EmulatedConsole
from agents.emulator.oracle import Field, Oracle
from agents.emulator.wire import BridgeWire, RmwWire
from agents.guard.description import Description
from agents.guard.links import Links
from agents.guard.monitor import Monitor
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.dvrk.psm import DvrkPsm
from benchmarks.robot_hostile import BRISK
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
    Phase,
    Policy,
    RobotState,
    Status,
    Waypoint,
)
from schemas.topics import ARM, EXECUTION, FRAME_NOTICE, HEARTBEAT, PLAN, ROBOT_STATE
from shared.clock import monotonic_ns, monotonic_s, now_ns
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import exp_so3, transform
from shared.ros.naming import RmwZenoh, Ros2dds
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session

DEADLINE_S = 20.0
BASE: Any = SIMULATED_T_CAMERA_BASE.tolist()
NAME, TOOL = "PSM1", "LARGE_NEEDLE_DRIVER:400006"
HZ = 200.0
PATIENT_S = 1.0
"""A test machine may stall; how soon silence ends a motion is measured by benchmarks/robot.py."""

AT_ONCE = replace(BRISK, contact_share=1.0)


def waypoint(place_mm: tuple[float, float, float], jaw_rad: float, phase: Phase, roll: float = 0.3) -> Waypoint:
    T = transform(exp_so3(np.array((0.1, 0, roll))), np.array(place_mm) / 1e3)
    return Waypoint(T, jaw_rad, phase, None)


WAYPOINTS = (
    waypoint((30, 8, 72), 1.0, Phase.APPROACH),
    waypoint((30, 8, 75), 0.3, Phase.CAPTURE),
    waypoint((31, 8, 75), 0.3, Phase.SLIDE, 0.4),
    waypoint((32, 8.5, 75), 0.3, Phase.SLIDE, 0.5),
    waypoint((32, 8.5, 75), -0.2, Phase.GRASP, 0.5),
)


def plan(plan_id: str, captured_ns: int) -> GraspPlan:
    stamp = FrameStamp(1, captured_ns, captured_ns, "c", (ChallengeEcho("psm1", captured_ns),))
    values: dict[str, Any] = {
        "status": Status.OK,
        "reason": "",
        "waypoints": WAYPOINTS,
        "s_goal": 0.5,
        "s_capture": 0.4,
    }
    values |= {"policy": Policy.CAPTURE_SLIDE_GRASP, "probability": 0.9, "slide_m": 0.002, "alternatives": ()}
    return GraspPlan(plan_id=plan_id, arm="psm1", goal_id="g", stamp=stamp, **values)


class Lab:
    """Everything of one arm; the bridge turns in `turn`, as its runner would have it."""

    def __init__(self, console: EmulatedConsole, session: zenoh.Session, backend: DvrkPsm, guard: "GuardHere") -> None:
        self.console, self.session, self.backend, self.guard = console, session, backend, guard
        config = RobotBridgeConfig(
            tick_hz=HZ,
            dead_man_s=PATIENT_S,
            first_heartbeat_s=PATIENT_S,
            maximum_frame_age_s=PATIENT_S,
            limits=AT_ONCE,
            calibration_id="c",
            registered_ns=now_ns(),
            tissue_needed=False,
        )
        self.bridge = RobotBridge(config, backend)
        self.said: list[Output | CommandAnswer] = []
        self.armings, self.stands_by = 0, True
        self._next_s = monotonic_s()
        self._oracle: Oracle = console._oracle

    def turn(self) -> None:
        """One turn of the bridge and of whoever stands by."""
        threading.Event().wait(max(0.0, self._next_s - monotonic_s()))
        self._next_s = max(self._next_s + 1 / HZ, monotonic_s())
        if self.stands_by and self.armings:
            self._oracle.heartbeat(monotonic_s())
            beat = Heartbeat("psm1", "p", now_ns(), f"arming-{self.armings}", *self.echo(), pressed=True)
            self.guard.beat(beat)
            self.said += self.bridge.step(Received(HEARTBEAT, "", 0, beat))
        self.said += self.bridge.step(Tick(now_ns()))
        self.see()

    def echo(self) -> tuple[int, int]:
        """The newest challenges, of the bridge and of the guard."""
        state = next((o.message for o in reversed(self.said) if isinstance(o, Output) and o.topic is ROBOT_STATE), None)
        return (0, 0) if state is None else (state.challenge_ns, state.guard_challenge)

    def see(self) -> None:
        """A camera takes a frame."""
        at_ns, (echo_ns, _) = now_ns(), self.echo()
        if echo_ns:
            stamp = FrameStamp(1, at_ns, at_ns, "c", (ChallengeEcho("psm1", echo_ns),))
            self.said += self.bridge.step(Received(FRAME_NOTICE, "", 0, FrameNotice(stamp)))

    def until(self, condition: Any) -> None:
        """Turn until a condition is true."""
        deadline_s = monotonic_s() + DEADLINE_S
        while not condition():
            assert monotonic_s() < deadline_s, (self.arm(), [e.reason for e in self.events()], self.verdict())
            self.turn()

    def arm(self) -> CommandAnswer:
        """Publish a plan and arm it."""
        self.said += self.bridge.step(Received(PLAN, "", 0, plan("p", now_ns())))
        return self.arm_again()

    def arm_again(self) -> CommandAnswer:
        """Arm the plan that was published last."""
        self.armings += 1
        header = CommandHeader(f"arming-{self.armings}", now_ns() + 10**9, "ann")
        message = Arm(header, "psm1", "p", self.echo()[0], pressed=True)
        said = list(self.bridge.step(Command(ARM, "psm1", message, now_ns())))
        self.said += said
        assert isinstance(said[0], CommandAnswer)
        return said[0]

    def ready(self) -> None:
        """Wait until the arm may be armed."""
        self.until(lambda: self.backend.state(now_ns()).reason == "" and self.echo()[0])

    def events(self) -> list[ExecutionEvent]:
        return [o.message for o in self.said if isinstance(o, Output) and o.topic is EXECUTION]

    def states(self) -> list[RobotState]:
        return [o.message for o in self.said if isinstance(o, Output) and o.topic is ROBOT_STATE]

    def verdict(self) -> dict[str, Any]:
        return self.console.verdict()

    def ask(self, word: str) -> None:
        """Have the emulated console do something."""
        self.session.put(f"emulator/{NAME}/request", word)


class GuardHere:
    """The guard's monitor with its own link to the robot's Zenoh, as its process has it."""

    def __init__(self, section: DvrkSection) -> None:
        rig = RigConfig(robot={"psm1": ArmSection(backend="dvrk", T_camera_base=BASE, dvrk=section)})
        document = document_of(rig, "psm1", section)
        document["description"]["rate_hz"] = HZ
        self.monitor, self.told = Monitor(Description.from_document(document["description"])), list[str]()
        self.links = Links(self.monitor, document, lambda what, why: self.told.append(f"{what}: {why}"))
        self._stopped, self._thread = threading.Event(), threading.Thread(target=self._run)
        self.links.open_robot()
        self._thread.start()

    def beat(self, beat: Heartbeat) -> None:
        """A heartbeat comes over the rig."""
        with self.links._lock:
            said = beat.arm, beat.arming_id, beat.guard_challenge, beat.pressed
            self.monitor.hear_heartbeat(*said, monotonic_ns())

    def _run(self) -> None:
        turn = 0
        while not self._stopped.wait(0.01):
            turn += 1
            self.links.turn()
            if turn % 2:
                self.links.challenge()

    def close(self) -> None:
        self._stopped.set()
        self._thread.join()
        for declared in self.links._kept:
            declared.undeclare()


@pytest.fixture
def codec() -> Literal["ros2dds", "rmw_zenoh"]:
    return "ros2dds"


@pytest.fixture
def dry_run() -> bool:
    return False


@pytest.fixture
def lab(codec: Literal["ros2dds", "rmw_zenoh"], dry_run: bool, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("agents.robot_bridge.measuring.MEASUREMENT_AGE_S", PATIENT_S)
    for bound in ("PRESENCE_NS", "LINK_NS", "FRESH_NS", "GONE_NS", "GRACE_NS"):
        monkeypatch.setattr(f"agents.guard.monitor.{bound}", round(PATIENT_S * 1e9))
    monkeypatch.setattr("agents.robot_bridge.dvrk.guard_link.LINK_S", PATIENT_S)
    monkeypatch.setattr("agents.robot_bridge.dvrk.guard_link.SILENCE_NS", round(PATIENT_S * 1e9))
    endpoint, stopped = free_local_endpoint(), threading.Event()
    oracle = Oracle(Field(SIMULATED_T_CAMERA_BASE), hears_heartbeats=True)
    with contextlib.ExitStack() as stack:
        stack.enter_context(open_router(endpoint))
        session = stack.enter_context(open_session(SessionSettings(endpoint=endpoint)))
        wire = BridgeWire(session) if codec == "ros2dds" else RmwWire(session, 3)
        console = stack.enter_context(contextlib.closing(EmulatedConsole(wire, NAME, oracle, Behaviour(ready=True))))
        stack.enter_context(answering(session, console))
        running = threading.Thread(target=console.run, args=(stopped,))
        running.start()
        stack.callback(lambda: (stopped.set(), running.join()))
        naming = Ros2dds() if codec == "ros2dds" else RmwZenoh(3)
        untold = ("teleoperation", "endoscope_arm", "clutch")
        backend = DvrkPsm(NAME, SessionSettings(endpoint=endpoint), naming, TOOL, dry_run, has_no=untold)
        section = DvrkSection(endpoint=endpoint, arm=NAME, codec=codec, domain=3 if codec == "rmw_zenoh" else 0)
        guard = stack.enter_context(contextlib.closing(GuardHere(section)))
        made = Lab(console, session, backend, guard)
        stack.enter_context(contextlib.closing(made.bridge))
        yield made


@pytest.fixture
def plan_of():
    """Makes a plan of an id for a frame of a time."""
    return plan
