"""A plan that was checked against tissue is repeated from a recording byte for byte, and needs that very surface."""

import dataclasses

import numpy as np
import pytest

from agents.planner.agent import Planner
from schemas.codec import decode
from schemas.messages import GraspPlan, RobotMode, RobotState, Status
from schemas.topics import GOAL, PLAN, ROBOT_STATE, SURFACE, THREAD, topic_of
from shared.kinematics import psm
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.runtime.agent import Agent, Output, Tick
from shared.runtime.replay import Lockstep, replay

JOINTS = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])


class Told(Agent):
    """Publishes one message at each tick, with the time as its own."""

    inputs, commands, tick_hz = (), (), 10.0

    def __init__(self, topic, instance, messages):
        self.kind, self.instance, self.outputs = topic.agent, instance, (topic,)
        self._messages = iter(messages)

    def step(self, arrived):
        if isinstance(arrived, Tick) and (message := next(self._messages, None)) is not None:
            yield Output(self.outputs[0], stamped(message, arrived.now_ns))


def stamped(message, now_ns):
    if isinstance(message, RobotState):
        return dataclasses.replace(message, measured_ns=now_ns)
    stamp = dataclasses.replace(message.stamp, capture_left_ns=now_ns, capture_right_ns=now_ns)
    return dataclasses.replace(message, stamp=stamp)


@pytest.fixture(scope="module")
def session(bench):
    """Two goals: the tissue has come nearer before the second one."""
    thread, base = bench.straight((-15, 3, 85), (15, -3, 88)), SIMULATED_BASES["psm1"]
    state = RobotState("psm1", 0, RobotMode.IDLE, psm.forward(JOINTS), JOINTS, 0.0, base, "")
    steps = Lockstep(
        Told(THREAD, "main", [thread] * 4),
        Told(SURFACE, "main", [bench.surface(87.0), None, bench.surface(80.0)]),
        Told(ROBOT_STATE, "psm1", [state] * 4),
        Planner(),
        rig="golden",
    )
    for name in ("first", "second"):
        steps.run(0.15)
        goal = bench.goal(s=0.5, name=name)
        header = dataclasses.replace(goal.header, deadline_ns=steps.now_ns + 10**9)
        steps.command(GOAL, dataclasses.replace(goal, header=header))
    return steps.entries


def test_a_plan_is_repeated_with_the_surface_that_it_was_checked_against(session):
    plans = [decode(GraspPlan, entry.payload) for entry in session if topic_of(entry.key) is PLAN]
    assert [plan.status for plan in plans] == [Status.OK, Status.FAILED]
    used = [next(c.sequence for c in plan.consumed if topic_of(c.key) is SURFACE) for plan in plans]
    assert used[0] < used[1]
    assert [made.same for made in replay(Planner, session)] == [True, True]


def test_without_that_surface_in_the_recording_nothing_is_claimed(session):
    surfaces = [entry for entry in session if topic_of(entry.key) is SURFACE]
    holed = [entry for entry in session if entry is not surfaces[-1]]
    first, second = replay(Planner, holed)
    assert first.same
    assert [topic_of(place.key) for place in second.missing] == [SURFACE]
