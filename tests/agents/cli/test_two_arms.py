"""Two arms of one rig, planned for and driven by the agents of its configuration, on a clock of the test's own."""

import numpy as np
import pytest

from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from schemas.messages import (
    Arm,
    CommandAnswer,
    CommandHeader,
    ExecutionKind,
    FrameStamp,
    GraspGoal,
    Heartbeat,
    Outcome,
    Policy,
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    ThreadReconstruction,
)
from schemas.topics import ARM, EXECUTION, GOAL, HEARTBEAT, PLAN, ROBOT_STATE, THREAD, key
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.config import parse_config

ARMS = ("psm1", "psm2")
RIG = parse_config("[planner]\n[robot.psm1]\n[robot.psm2]", RigConfig, "rig.toml")
START_NS, TICK_NS = 1_700_000_000_000_000_000, 10_000_000
LONGEST_TICKS = 6000
NONE = np.zeros(0)


def thread():
    return ThreadReconstruction(
        stamp=FrameStamp(1, START_NS, START_NS, "hand"),
        camera=RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 0.0055, 1.0),
        status=Status.OK,
        reason="",
        method="by hand",
        degree=1,
        knots=np.array([0.0, 0.0, 1.0, 1.0]),
        control_points_camera=np.array([[-0.02, 0, 0.08], [0.02, 0.005, 0.085]]),
        regions=ReliabilityRegions(NONE, np.zeros((0, 3)), np.zeros((0, 2)), NONE, NONE),
        confidence_s=np.array([0.0, 1.0]),
        confidence=np.array([1.0, 1.0]),
    )


def received(topic, message, instance="main"):
    return Received(topic, key(RIG.rig, topic, instance), 0, message)


def outputs(said, topic):
    return [o.message for o in said if isinstance(o, Output) and o.topic is topic]


@pytest.fixture
def bridges():
    return {arm: build(RIG, "robot_bridge", arm) for arm in ARMS}


@pytest.fixture
def planned(bridges):
    """The plan for each arm."""
    planner = build(RIG, "planner", "main")
    list(planner.step(received(THREAD, thread())))
    for arm, bridge in bridges.items():
        (state,) = outputs(bridge.step(Tick(START_NS)), ROBOT_STATE)
        list(planner.step(received(ROBOT_STATE, state, arm)))

    def plan_for(arm):
        header = CommandHeader(f"goal-{arm}", START_NS, "a test")
        goal = GraspGoal(header, arm, Policy.CAPTURE_SLIDE_GRASP, 0.4, None, None)
        (plan,) = outputs(planner.step(Command(GOAL, "main", goal, START_NS)), PLAN)
        assert plan.status is Status.OK, plan.reason
        return plan

    return {arm: plan_for(arm) for arm in ARMS}


def answer_of(bridge, arm, plan):
    armed = Arm(CommandHeader("arming", START_NS, "a test"), arm, plan.plan_id)
    (answer,) = [a for a in bridge.step(Command(ARM, arm, armed, START_NS)) if isinstance(a, CommandAnswer)]
    return answer


@pytest.mark.parametrize(("arm", "other"), [ARMS, ARMS[::-1]])
def test_each_arm_carries_out_the_plan_that_was_made_for_it_and_no_other(arm, other, bridges, planned):
    bridge, plan, told = bridges[arm], planned[arm], []
    list(bridge.step(received(PLAN, planned[other])))
    assert answer_of(bridge, arm, planned[other]).code == "other_arm"
    list(bridge.step(received(PLAN, plan)))
    assert answer_of(bridge, arm, plan).outcome is Outcome.ACCEPTED
    for tick in range(1, LONGEST_TICKS):
        now_ns = START_NS + tick * TICK_NS
        list(bridge.step(received(HEARTBEAT, Heartbeat(arm, plan.plan_id, now_ns, "arming"), arm)))
        told += outputs(bridge.step(Tick(now_ns)), EXECUTION)
        if told and told[-1].kind in (ExecutionKind.FINISHED, ExecutionKind.HELD):
            break
    assert (told[-1].kind, told[-1].reason) == (ExecutionKind.FINISHED, "")
