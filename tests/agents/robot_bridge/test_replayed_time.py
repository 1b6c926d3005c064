"""A real arm does not live in the time of a recording; a simulated one may."""

import dataclasses

import numpy as np

from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.refusals import Code
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import (
    Arm,
    CommandAnswer,
    CommandHeader,
    ExecutionKind,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    Outcome,
    Phase,
    Policy,
    ReplayClock,
    Status,
    Waypoint,
)
from schemas.topics import ARM, EXECUTION, HEARTBEAT, PLAN, REPLAY_CLOCK
from shared.rigid_transforms import transform
from shared.runtime.agent import Command, Output, Received, Tick

SECOND, TICK = 10**9, 10**7
BEGIN = 1_700_000_000 * SECOND


class RealPsm(SimulatedPsm):
    """Behaves as a simulated arm, and owes what a real one owes."""

    accepts_replayed_time = False


def plan(now_ns, plan_id="p1"):
    places = ((15, 5, 60), (15, 5, 75), (20, 6, 75))
    phases = (Phase.APPROACH, Phase.CAPTURE, Phase.GRASP)
    waypoints = tuple(
        Waypoint(transform(np.eye(3), np.array(place) / 1e3), 0.3, phase, None)
        for place, phase in zip(places, phases, strict=True)
    )
    return GraspPlan(
        plan_id=plan_id,
        arm="psm1",
        goal_id="g",
        stamp=FrameStamp(0, now_ns, now_ns, ""),
        status=Status.OK,
        reason="",
        policy=Policy.DIRECT,
        s_goal=0.5,
        s_capture=0.5,
        probability=0.9,
        slide_m=0.0,
        waypoints=waypoints,
        alternatives=(),
    )


class Driven:
    """A bridge that ticks, with a heartbeat before each tick once it is armed."""

    def __init__(self, backend):
        self.bridge, self.now_ns, self.armed = RobotBridge(RobotBridgeConfig(), backend), BEGIN, ""
        self.events = []
        self.tick()

    def feed(self, topic, message):
        self._note(self.bridge.step(Received(topic, f"suturegrasp/test/{topic}", 0, message)))

    def tick(self, count=1, step_ns=TICK):
        for _ in range(count):
            self.now_ns += step_ns
            if self.armed:
                self.feed(HEARTBEAT, Heartbeat("psm1", "p1", self.now_ns, self.armed))
            self._note(self.bridge.step(Tick(self.now_ns)))

    def arm(self):
        header = CommandHeader(f"arming at {self.now_ns}", self.now_ns + SECOND, "a test")
        replies = list(self.bridge.step(Command(ARM, "psm1", Arm(header, "psm1", "p1"), self.now_ns)))
        self._note(replies)
        (answer,) = [r for r in replies if isinstance(r, CommandAnswer)]
        self.armed = header.id if answer.outcome is Outcome.ACCEPTED else ""
        return answer

    def _note(self, replies):
        self.events += [r.message for r in replies if isinstance(r, Output) and r.topic is EXECUTION]


def test_a_real_arm_is_not_armed_while_a_recording_is_replayed_and_is_once_that_is_over():
    driven = Driven(RealPsm())
    driven.feed(PLAN, plan(driven.now_ns))
    driven.feed(REPLAY_CLOCK, ReplayClock(BEGIN - 3600 * SECOND, 1.0))
    refused = driven.arm()
    assert refused.code == Code.REPLAY
    assert "a recording is replayed" in refused.reason
    driven.tick(250)
    assert driven.arm().outcome is Outcome.ACCEPTED


def test_a_plan_that_came_during_a_replay_moves_no_real_arm_afterwards():
    driven = Driven(RealPsm())
    driven.feed(REPLAY_CLOCK, ReplayClock(BEGIN, 1.0))
    driven.feed(PLAN, plan(driven.now_ns))
    driven.tick(250)
    assert driven.arm().code == Code.REPLAY


def test_a_real_arm_that_moves_holds_when_a_replay_begins():
    driven = Driven(RealPsm())
    driven.feed(PLAN, plan(driven.now_ns))
    assert driven.arm().outcome is Outcome.ACCEPTED
    driven.tick(20)
    driven.feed(REPLAY_CLOCK, ReplayClock(BEGIN, 1.0))
    assert (driven.events[-1].kind, driven.events[-1].code) == (ExecutionKind.HELD, Code.REPLAY)
    before = driven.bridge._backend.state(driven.now_ns).joints
    driven.tick(20)
    np.testing.assert_array_equal(driven.bridge._backend.state(driven.now_ns).joints, before)


def test_a_simulated_arm_listens_to_no_replay_clock_since_its_ticks_are_in_that_time_already():
    simulated, real = (RobotBridge(RobotBridgeConfig(), backend()) for backend in (SimulatedPsm, RealPsm))
    assert simulated.accepts_replayed_time
    assert not real.accepts_replayed_time
    assert REPLAY_CLOCK not in [i.topic for i in simulated.inputs]
    assert REPLAY_CLOCK in [i.topic for i in real.inputs]


def test_an_arm_holds_where_a_replay_ends_or_begins_under_it():
    for jump_ns in (3600 * SECOND, -3600 * SECOND):
        driven = Driven(SimulatedPsm())
        driven.feed(PLAN, plan(driven.now_ns))
        assert driven.arm().outcome is Outcome.ACCEPTED
        driven.tick(20)
        assert driven.events[-1].kind is not ExecutionKind.HELD
        # the heartbeat of whoever stands by was sent by another clock
        driven.now_ns += jump_ns
        driven._note(driven.bridge.step(Tick(driven.now_ns)))
        assert driven.events[-1].kind is ExecutionKind.HELD
        assert dataclasses.asdict(driven.events[-1])["reason"]
