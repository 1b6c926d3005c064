"""After a grasp: the check, the next attempt and its limit; and that all of it is repeated from a recording."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from schemas.codec import decode
from schemas.messages import Checked, ExecutionEvent, ExecutionKind, Policy, RobotMode, RobotState, Status
from schemas.topics import CHECK, EXECUTION, GOAL, PLAN, ROBOT_STATE, SURFACE, THREAD, topic_of
from shared.kinematics import psm
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import compose, inverse
from shared.runtime.agent import Output
from shared.runtime.replay import Lockstep, replay
from tests.agents.planner import bench

MS = 1_000_000
BASE = SIMULATED_BASES["psm1"]
JOINTS = np.array([0.0, 0, 0.1, 0, 0, 0])
UNSURE = (0.05, 0.05, 8.0)


def planner():
    return Planner(PlannerConfig(least_probability=0.0, aside_m=0.0))


class Lab:
    """A planner with an arm that reaches its thread, fed as it would be live; times are in ms since it began."""

    def __init__(self):
        self.steps = Lockstep(planner(), rig="golden")
        self.began_ns = self.steps.now_ns
        self.see(THREAD, bench.bent(), 0)
        self.report(JOINTS, 0)

    def tell(self, topic, message, instance="main") -> list[Any]:
        """What the planner says to that."""
        before = len(self.steps.entries)
        self.steps.tell([Output(topic, message)], instance)
        said = [entry for entry in self.steps.entries[before:] if topic_of(entry.key) in (PLAN, CHECK)]
        return [decode(topic_of(entry.key).message, entry.payload) for entry in said]

    def see(self, topic, message, at_ms):
        at_ns = self.began_ns + at_ms * MS
        stamp = dataclasses.replace(message.stamp, capture_left_ns=at_ns, capture_right_ns=at_ns)
        return self.tell(topic, dataclasses.replace(message, stamp=stamp))

    def lifted(self, at_ms, lifted_mm=0.0, **rest):
        return self.see(THREAD, bench.bent(-lifted_mm * bench.near_middle(15.0) * [0, 0, 1], **rest), at_ms)

    def report(self, joints, at_ms):
        told = psm.forward(joints), joints, 0.0, BASE, ""
        self.tell(ROBOT_STATE, RobotState("psm1", self.began_ns + at_ms * MS, RobotMode.IDLE, *told), "psm1")

    def plan(self, attempts=None, at_ms=50, policy=Policy.DIRECT, name="g1") -> Any:
        self.steps.now_ns = self.began_ns + at_ms * MS
        goal = bench.goal(s=0.5, policy=policy, name=name)
        header = dataclasses.replace(goal.header, deadline_ns=self.steps.now_ns + 10**9)
        self.steps.command(GOAL, dataclasses.replace(goal, header=header, attempts=attempts))
        return self.steps.last[PLAN]

    def carry_out(self, plan, at_ms, *kinds):
        self.report(psm.inverse(compose(inverse(BASE), plan.waypoints[-1].T_camera_tool)[None]).joints[0], at_ms)
        for kind in (ExecutionKind.ACCEPTED, *(kinds or (ExecutionKind.FINISHED,))):
            why = ("hold_command", "ann said hold") if kind is ExecutionKind.HELD else ("", "")
            at_ns = self.began_ns + at_ms * MS
            self.tell(EXECUTION, ExecutionEvent(plan.plan_id, "psm1", at_ns, kind, None, *why), "psm1")


@pytest.fixture
def lab():
    """All that its planner says in a test, a replay says again, byte for byte."""
    made = Lab()
    yield made
    outcomes = list(replay(planner, made.steps.entries))
    assert outcomes
    assert all(outcome.same for outcome in outcomes)


def test_a_miss_is_noticed_and_planned_again_up_to_the_limit(lab):
    plan = lab.plan(attempts=2)
    assert plan.status is Status.OK, plan.reason
    lab.carry_out(plan, 1000)
    assert lab.lifted(1100) == [], "too early to have been captured after the lift"
    check, again = lab.lifted(1200)
    assert (check.verdict, check.attempt, check.attempts) == (Checked.MISSED, 1, 2)
    assert (again.plan_id, again.attempt, again.goal_id) == (check.next_plan_id, 2, "g1")
    assert lab.lifted(1300) == [], "it is checked once"
    lab.carry_out(again, 2000)
    (last,) = lab.lifted(2200)
    assert (last.verdict, last.next_plan_id) == (Checked.MISSED, "")
    assert "the last" in last.sentence


@pytest.mark.parametrize("holds", [False, True])
def test_a_segment_that_has_ended_is_gone_on_from_by_an_image_that_was_taken_since_unless_the_arm_holds(lab, holds):
    plan = lab.plan(attempts=2)
    lab.carry_out(plan, 1000, ExecutionKind.SEGMENT_ENDED, *[ExecutionKind.HELD] * holds)
    assert lab.lifted(990) == [], "it was seen before the segment had ended"
    made = lab.lifted(1010)
    assert len(made) == (not holds)
    for on in made:
        assert (on.status, on.continues, on.goal_id) == (Status.OK, plan.plan_id, plan.goal_id)
        assert (on.attempt, on.plan_id != plan.plan_id) == (plan.attempt, True)
    assert lab.lifted(1020) == [], "it is planned on once"


def test_what_is_held_needs_no_further_attempt_and_what_cannot_be_told_in_the_end_is_planned_again(lab):
    lab.carry_out(lab.plan(), 1000)
    (check,) = lab.lifted(1200, lifted_mm=5.0)
    assert (check.verdict, check.next_plan_id) == (Checked.HELD, "")
    lab.lifted(2400)
    lab.report(JOINTS, 2400)
    lab.carry_out(lab.plan(at_ms=2500), 3000)
    assert lab.lifted(3200, deviations_mm=UNSURE) == []
    check, again = lab.lifted(5200, deviations_mm=UNSURE)
    assert (check.verdict, check.next_plan_id) == (Checked.UNKNOWN, again.plan_id)
    assert "another one is planned, and lets go first" in check.sentence
    np.testing.assert_array_equal(again.offset_camera, np.zeros(3), "what cannot be told teaches nothing")


@pytest.mark.parametrize("compared", [True, False])
def test_what_is_likelier_held_than_missed_is_not_let_go_nor_is_what_was_not_compared_at_all(lab, compared):
    lab.carry_out(lab.plan(), 1000)
    unsaid = {"posterior_s": np.zeros(0), "posterior_covariance": np.zeros((0, 3, 3))}
    thread = bench.bent(-5.0 * bench.near_middle(15.0) * [0, 0, 1], UNSURE)
    (check,) = lab.see(THREAD, thread if compared else dataclasses.replace(thread, **unsaid), 3200)
    assert (check.verdict, check.next_plan_id) == (Checked.UNKNOWN, "")
    assert 0.5 < check.held_probability < 0.99 if compared else check.held_probability is None


def test_a_plan_is_repeated_only_with_the_surface_that_it_was_checked_against(lab):
    plans = []
    for name, depth_mm in (("first", 90.0), ("second", 82.0)):
        lab.see(SURFACE, bench.surface(depth_mm), 0)
        plans.append(lab.plan(policy=Policy.CAPTURE_SLIDE_GRASP, name=name))
    assert [plan.status for plan in plans] == [Status.OK, Status.FAILED]
    used = [next(c.sequence for c in plan.consumed if topic_of(c.key) is SURFACE) for plan in plans]
    assert used == [0, 1]
    surfaces = [entry for entry in lab.steps.entries if topic_of(entry.key) is SURFACE]
    first, second = replay(planner, [entry for entry in lab.steps.entries if entry is not surfaces[-1]])
    assert first.same
    assert [topic_of(place.key) for place in second.missing] == [SURFACE], "without it nothing is claimed"
