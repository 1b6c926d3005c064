"""After a grasp: held, missed or unknown by what two reconstructions show, the next attempt, the limit, and replays."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import scipy.integrate
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.agent import Planner
from agents.planner.attempt import next_attempt
from agents.planner.check import checked, held_probability
from agents.planner.config import PlannerConfig
from agents.planner.curve import curve_of
from agents.planner.learning import after_miss
from agents.planner.moved import END_M, Motion, motion
from agents.planner.plan import plan_grasp
from schemas.codec import decode
from schemas.messages import (
    Checked,
    ExecutionEvent,
    ExecutionKind,
    GraspCheck,
    GraspPlan,
    Policy,
    RobotMode,
    RobotState,
    Status,
    ThreadAround,
)
from schemas.topics import CHECK, EXECUTION, GOAL, PLAN, ROBOT_STATE, THREAD, key, topic_of
from shared.kinematics import psm
from shared.kinematics.psm import FINGER_M
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import compose, inverse
from shared.runtime.agent import Command, Output, Received
from shared.runtime.replay import Lockstep, replay

MS = 1_000_000
MM = 1e-3
BASE = SIMULATED_BASES["psm1"]
CONFIG = PlannerConfig(aside_m=0.0)
"""Lifts alone, which leave more untold."""
JOINTS = np.array([0.0, 0, 0.1, 0, 0, 0])
X = np.linspace(-40, 40, 33)


def told(bench, lifted_mm=0.0, all_mm=0.0, sigma_mm=0.3, late_ms=0):
    """A bent thread, its middle lifted towards the camera, and all of it farther away; with what it is known to."""
    z = 88 + all_mm - lifted_mm * np.maximum(1 - (X / 15) ** 2, 0) ** 2
    thread = bench.thread(np.column_stack((X, 6 * np.sin(X / 13), z)))
    stamp = dataclasses.replace(
        thread.stamp,
        capture_left_ns=bench.CAPTURED_NS + late_ms * MS,
        capture_right_ns=bench.CAPTURED_NS + late_ms * MS,
    )
    covariance = np.tile(np.diag([0.05, 0.05, sigma_mm]) ** 2, (9, 1, 1))
    return dataclasses.replace(thread, stamp=stamp, posterior_s=np.linspace(0, 1, 9), posterior_covariance=covariance)


def planned(bench, **rest) -> GraspPlan:
    return plan_grasp(bench.goal(s=0.5, policy=Policy.DIRECT), told(bench, **rest), bench.arm(), CONFIG)


def tool_after(plan):
    return plan.waypoints[-1].T_camera_tool


@pytest.mark.parametrize(
    ("after", "verdict"),
    [
        ({"lifted_mm": 5.0}, Checked.HELD),
        ({}, Checked.MISSED),
        ({"all_mm": 4.0}, Checked.MISSED),
        ({"lifted_mm": 5.0, "all_mm": 4.0}, Checked.HELD),
        ({"lifted_mm": 2.5}, Checked.UNKNOWN),
        ({"lifted_mm": 5.0, "sigma_mm": 8.0}, Checked.UNKNOWN),
    ],
)
def test_thread_that_moved_with_the_tool_is_held_and_what_is_unsure_is_unknown(bench, after, verdict):
    plan = planned(bench)
    seen = checked(plan, told(bench, **after), tool_after(plan), CONFIG)
    assert seen.verdict is verdict, seen.sentence


def unsaid(thread):
    """The same thread, without how sure it is."""
    return dataclasses.replace(thread, posterior_s=np.zeros(0), posterior_covariance=np.zeros((0, 3, 3)))


def test_nothing_is_claimed_of_thread_that_is_not_seen_or_not_known_how_well(bench):
    plan = planned(bench)
    for after in (bench.failed(), unsaid(told(bench, lifted_mm=5.0))):
        assert checked(plan, after, tool_after(plan), CONFIG).verdict is Checked.UNKNOWN


@pytest.mark.parametrize(
    ("axis", "moved_mm", "why"),
    [
        (2, 0.0, "the tool moved by only 0.0 mm"),
        (2, 1.5, "by only 1.5 mm"),
        (0, 6.0, "the tool moved along the thread"),
    ],
)
def test_a_tool_that_moved_too_little_or_along_the_thread_is_named_for_it(bench, axis, moved_mm, why):
    plan = planned(bench)
    moved = plan.waypoints[-2].T_camera_tool.copy()
    moved[:3, 3] += moved_mm * MM * moved[:3, axis]
    seen = checked(plan, told(bench), moved, CONFIG)
    assert (seen.verdict, seen.doubtful) == (Checked.UNKNOWN, False)
    assert why in seen.sentence


@settings(max_examples=15)
@given(
    st.tuples(*[st.floats(-9, 9)] * 2),
    st.tuples(*[st.floats(0.05, 3)] * 2),
    st.floats(-0.9, 0.9),
    st.floats(0, 3.2),
    st.tuples(*[st.floats(-9, 9)] * 3),
)
def test_the_probability_of_being_held_is_that_of_its_derivation(moved_mm, sigma_mm, correlation, turn, whole_mm):
    tool, thread = np.array([7.0, 5.0]) * MM, np.array(moved_mm) * MM
    tool_moved, whole, of_whole = np.array([1.0, 5.0, 7.0]) * MM, np.array(whole_mm) * MM, (0.4 * MM) ** 2 * np.eye(3)
    sigma = np.array(sigma_mm) * MM
    covariance = np.outer(sigma, sigma) * np.array([[1.0, correlation], [correlation, 1.0]])
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    opens = np.array([0.0, np.cos(turn), np.sin(turn)])
    missed = covariance + (0.7 * MM) ** 2 * np.eye(2)
    # what the fingers are off by: 0.7 mm on each axis, and 1.5 mm anywhere in a ball
    opened = np.array([np.sin(turn), np.cos(turn)])
    held = missed + ((0.7 * MM) ** 2 + (1.5 * MM) ** 2 / 5) * np.outer(opened, opened)

    def density(off, spread):
        beside = scipy.stats.norm.pdf(off[1], scale=np.sqrt(spread[1, 1]))
        normal = scipy.stats.multivariate_normal.pdf(off, cov=spread)
        # depths within 30 mm are alike, and so is all within 15 by 6 mm to either side
        return 0.979 * normal + 0.02 * beside / 0.03 + 0.001 / (4 * 0.015 * 0.006)

    def by_chance(off, sigma_mm):
        return scipy.stats.multivariate_normal.pdf(off, cov=of_whole + (sigma_mm * MM) ** 2 * np.eye(3))

    # breathing by 2 mm; one look in ten wrong as a whole by 10; or by the tool, evenly up to all of its way
    by_itself = 0.9 * by_chance(whole, 2.0) + 0.1 * by_chance(whole, 10.0)
    by_tool = scipy.integrate.quad(lambda share: float(by_chance(whole - share * tool_moved, 2.0)), 0, 1)[0]
    as_held = 0.5 * density(thread - tool, held) * by_itself
    as_held += 0.5 * density(thread + axes @ whole - tool, held) * by_tool
    expected = as_held / (as_held + density(thread, missed) * by_itself)
    motion_ = Motion(tool, thread, covariance, axes, 0.0, tool_moved, whole, of_whole)
    assert held_probability(motion_, opens, CONFIG) == pytest.approx(expected, rel=1e-3, abs=1e-9)


def along(points_mm, sigma_mm=0.1):
    points = np.asarray(points_mm) * MM
    covariance = np.tile(np.eye(3) * (sigma_mm * MM) ** 2, (len(points), 1, 1))
    return ThreadAround(np.linspace(0, 1, len(points)), points, covariance)


@pytest.mark.parametrize(("beside_mm", "same"), [(4.0, True), (7.0, False)])
def test_thread_that_passes_the_goal_far_beside_is_another_strand(beside_mm, same):
    x = np.linspace(-40, 40, 161)
    before = along(np.column_stack((x, 0 * x, 0 * x + 88)))
    # far from the goal it lies where it lay
    after = along(np.column_stack((x, np.where(np.abs(x) < 10, beside_mm, 0.0), 0 * x + 88)))
    found = motion(before, 80, after, np.array([0.0, 0.0, -5.0]) * MM, np.ones(len(x), bool))
    assert isinstance(found, Motion) is same


def bent(bench, z, y: Any = 0.0):
    """The thread of `told` with other heights, and moved to the side."""
    thread = bench.thread(np.column_stack((X, 6 * np.sin(X / 13) + y, z)))
    covariance = np.tile(np.diag([0.05, 0.05, 0.3]) ** 2, (9, 1, 1))
    return dataclasses.replace(thread, posterior_s=np.linspace(0, 1, 9), posterior_covariance=covariance)


def piece(bench, lifted_mm, begins_mm):
    """The thread from so far beside its middle on, which is all that is seen of it; its middle lifted."""
    whole = curve_of(bent(bench, 88 - lifted_mm * np.maximum(1 - (X / 25) ** 2, 0) ** 2))
    s = np.linspace(0.5 + 1e-3 * begins_mm / whole.length_m, 1.0, 33)
    seen = bench.thread(whole.points(s) / MM)
    covariance = np.tile(np.diag([0.05, 0.05, 0.3]) ** 2, (9, 1, 1))
    return dataclasses.replace(seen, posterior_s=np.linspace(0, 1, 9), posterior_covariance=covariance)


@pytest.mark.parametrize("begins_mm", [1.0, 6.0])
@pytest.mark.parametrize(("lifted_mm", "verdict"), [(5.0, Checked.HELD), (0.0, Checked.MISSED)])
def test_where_no_thread_is_seen_at_the_jaws_the_thread_beside_them_tells(bench, begins_mm, lifted_mm, verdict):
    plan = planned(bench)
    seen = checked(plan, piece(bench, lifted_mm, begins_mm + END_M / MM), tool_after(plan), CONFIG)
    assert " mm from the goal, where nothing of it is seen, moved" in seen.sentence
    assert seen.held_probability is not None
    assert (seen.held_probability > 0.5) is (verdict is Checked.HELD)
    assert (seen.verdict is verdict) is (begins_mm == 1.0), seen.sentence


def test_where_nothing_near_the_jaws_is_seen_it_is_unknown_and_what_may_be_held_is_not_let_go(bench):
    plan = planned(bench)
    seen = checked(plan, piece(bench, 5.0, 18.0), tool_after(plan), CONFIG)
    assert (seen.verdict, seen.doubtful) == (Checked.UNKNOWN, False)
    assert "no thread is seen near the jaws after the lift" in seen.sentence
    made_up = dataclasses.replace(piece(bench, 5.0, 7.0), hidden=np.array([[0.0, 0.9]]))
    seen = checked(plan, made_up, tool_after(plan), CONFIG)
    assert (seen.verdict, seen.motion) == (Checked.UNKNOWN, None), seen.sentence


@pytest.mark.parametrize(("share", "held"), [(1.0, True), (0.7, True), (0.0, False), (-0.5, False)])
def test_limp_thread_that_the_tool_drags_along_as_a_whole_is_likelier_held(bench, share, held):
    """By all of the tool's way at the goal, and by a share of it everywhere else; or by itself, away from it."""
    plan = planned(bench)
    after = tool_after(plan)
    tool = after[:3, 3] - plan.waypoints[-2].T_camera_tool[:3, 3]
    near = np.maximum(1 - (X / 25) ** 2, 0) ** 2 if held else 0.0 * X
    points = np.column_stack((X, 6 * np.sin(X / 13), np.full(len(X), 88.0)))
    moved = points + (share + (1 - share) * near)[:, None] * tool / MM
    covariance = np.tile(np.diag([0.05, 0.05, 0.3]) ** 2, (9, 1, 1))
    thread = bench.thread(moved)
    seen = checked(
        plan,
        dataclasses.replace(thread, posterior_s=np.linspace(0, 1, 9), posterior_covariance=covariance),
        after,
        CONFIG,
    )
    assert seen.held_probability is not None
    # tissue that breathes might carry it so far too
    assert seen.held_probability > 0.5 if held else seen.verdict is Checked.MISSED, seen.sentence


def test_thread_that_was_taken_to_be_elsewhere_is_likelier_missed(bench):
    plan = planned(bench)
    aside = bent(bench, np.full(len(X), 88.0), np.where(np.abs(X) < 18, 9.0, 0.0))
    seen = checked(plan, aside, tool_after(plan), CONFIG)
    assert (seen.verdict, seen.doubtful) == (Checked.UNKNOWN, True), seen.sentence
    assert "mm from the way of the tool" in seen.sentence


def test_thread_follows_by_less_the_farther_from_the_goal_it_is_looked_at():
    tool = np.array([7.0, 5.0]) * MM
    near, far = (Motion(tool, tool, 1e-8 * np.eye(2), np.eye(2, 3), beside_m) for beside_m in (0.0, 0.015))
    np.testing.assert_allclose(near.follows, tool)
    np.testing.assert_array_equal(near.follows_covariance, 0.0)
    # 61 % of the way, give or take 27 %: as good as all of it, or a quarter
    np.testing.assert_allclose(far.follows, 0.61 * tool)
    np.testing.assert_allclose(far.follows_covariance, 0.27**2 * np.outer(tool, tool))


@pytest.mark.parametrize("cut_mm", [0.0, 2.0, 4.0])
def test_an_end_that_is_seen_too_short_is_the_less_sure_the_farther_it_goes_on(cut_mm):
    x = np.linspace(-40, 40, 161)
    before = along(np.column_stack((x, 0 * x, 0 * x + 88)))
    seen = x[x <= 38 - cut_mm]
    after = along(np.column_stack((seen, 0 * seen, 0 * seen + 88)))
    found = motion(before, 156, after, np.array([0.0, 5.0, 0.0]) * MM, np.ones(len(seen), bool))
    assert isinstance(found, Motion)
    # 30 % of what it goes on by in depth, 15 % in the image, beside what both are known to
    deviations_mm = np.sqrt(np.diag(found.covariance)) / MM
    np.testing.assert_allclose(deviations_mm, np.hypot((0.3 * cut_mm, 0.15 * cut_mm), 0.153), atol=0.01)


def test_a_miss_moves_the_offset_to_where_the_fingers_would_have_missed_and_the_aim_makes_up_for_it(bench):
    config = PlannerConfig(depths_m=(0.002,))
    goal, thread = bench.goal(s=0.5, policy=Policy.DIRECT), told(bench, sigma_mm=0.1)
    plan = plan_grasp(goal, thread, bench.arm(), config)
    known = after_miss(plan, config)
    approach = plan.waypoints[0].T_camera_tool[:3, 2]
    # fingers that end 2 mm beyond the thread have missed it by being too far back, likelier than by any other way
    assert known.mean_camera @ approach < -0.1 * MM
    attempt = next_attempt(plan, Checked.MISSED, config)
    again = plan_grasp(goal, thread, bench.arm(), config, attempt=attempt)
    first, second = (p.waypoints[1].T_camera_tool @ [0, 0, FINGER_M - (p.depth_m or 0.0), 1] for p in (plan, again))
    np.testing.assert_allclose((second - first)[:3], -known.mean_camera, atol=1e-9)
    assert (again.attempt, again.attempts, again.plan_id) == (2, 3, "plan-g1-2")


class Bench:
    """A planner with an arm that reaches its thread, fed as it would be live."""

    def __init__(self, bench):
        self.bench, self.planner = bench, Planner(PlannerConfig(least_probability=0.0, aside_m=0.0))
        self.feed(THREAD, told(bench))
        self.report(JOINTS)

    def feed(self, topic, message, instance="main") -> list[Any]:
        return list(self.planner.step(Received(topic, key("lab", topic, instance), 0, message)))

    def report(self, joints, late_ms=0):
        state = RobotState(
            "psm1", self.bench.CAPTURED_NS + late_ms * MS, RobotMode.IDLE, psm.forward(joints), joints, 0.0, BASE, ""
        )
        self.feed(ROBOT_STATE, state, "psm1")

    def plan(self, attempts=None, after_ms=50) -> GraspPlan:
        goal = dataclasses.replace(self.bench.goal(s=0.5, policy=Policy.DIRECT), attempts=attempts)
        _, output = list[Any](self.planner.step(Command(GOAL, "main", goal, self.bench.CAPTURED_NS + after_ms * MS)))
        return output.message

    def carry_out(self, plan, after_ms):
        lifted = compose(inverse(BASE), plan.waypoints[-1].T_camera_tool)
        self.report(psm.inverse(lifted[None]).joints[0])
        self.report_of(plan, after_ms, ExecutionKind.ACCEPTED, ExecutionKind.FINISHED)

    def report_of(self, plan, after_ms, *kinds):
        at_ns = self.bench.CAPTURED_NS + after_ms * MS
        for kind in kinds:
            why = ("hold_command", "ann said hold") if kind is ExecutionKind.HELD else ("", "")
            self.feed(EXECUTION, ExecutionEvent(plan.plan_id, "psm1", at_ns, kind, None, *why), "psm1")

    def see(self, late_ms, **rest) -> list[Output]:
        return self.feed(THREAD, told(self.bench, late_ms=late_ms, **rest))


def test_a_miss_is_noticed_and_planned_again_up_to_the_limit(bench):
    lab = Bench(bench)
    plan = lab.plan(attempts=2)
    assert plan.status is Status.OK, plan.reason
    lab.carry_out(plan, 1000)
    assert lab.see(1100) == [], "too early to have been captured after the lift"
    check, again = (output.message for output in lab.see(1200))
    assert (check.verdict, check.attempt, check.attempts) == (Checked.MISSED, 1, 2)
    assert (again.plan_id, again.attempt, again.goal_id) == (check.next_plan_id, 2, "g1")
    assert lab.see(1300) == [], "it is checked once"
    lab.carry_out(again, 2000)
    (last,) = (output.message for output in lab.see(2200))
    assert (last.verdict, last.next_plan_id) == (Checked.MISSED, "")
    assert "the last" in last.sentence


def test_a_segment_that_has_ended_is_gone_on_from_by_a_plan_of_an_image_that_was_taken_since(bench):
    lab = Bench(bench)
    plan = lab.plan(attempts=2)
    lab.report_of(plan, 1000, ExecutionKind.ACCEPTED, ExecutionKind.SEGMENT_ENDED)
    assert lab.see(990) == [], "it was seen before the segment had ended"
    (on,) = (output.message for output in lab.see(1010))
    assert (on.status, on.continues, on.goal_id, on.attempt) == (Status.OK, plan.plan_id, plan.goal_id, plan.attempt)
    assert on.plan_id != plan.plan_id
    assert lab.see(1020) == [], "it is planned on once"


def test_a_segment_after_which_the_arm_holds_is_not_gone_on_from(bench):
    lab = Bench(bench)
    lab.report_of(lab.plan(), 1000, ExecutionKind.ACCEPTED, ExecutionKind.SEGMENT_ENDED, ExecutionKind.HELD)
    assert lab.see(1100) == []


def test_what_is_held_needs_no_further_attempt_and_what_cannot_be_told_in_the_end_is_said_to_be_and_planned_again(
    bench,
):
    lab = Bench(bench)
    lab.carry_out(lab.plan(), 1000)
    (output,) = lab.see(1200, lifted_mm=5.0)
    assert (output.topic, output.message.verdict, output.message.next_plan_id) == (CHECK, Checked.HELD, "")
    lab.see(2400)
    lab.report(JOINTS, 2400)
    lab.carry_out(lab.plan(after_ms=2500), 3000)
    assert lab.see(3200, sigma_mm=8.0) == []
    check, again = (output.message for output in lab.see(5200, sigma_mm=8.0))
    assert (check.verdict, check.next_plan_id) == (Checked.UNKNOWN, again.plan_id)
    assert "another one is planned, and lets go first" in check.sentence
    np.testing.assert_array_equal(again.offset_camera, np.zeros(3), "what cannot be told teaches nothing")


def test_what_is_likelier_held_than_missed_is_not_let_go_nor_is_what_was_not_compared_at_all(bench):
    for after in (told(bench, late_ms=3200, lifted_mm=5.0, sigma_mm=8.0), unsaid(told(bench, late_ms=3200))):
        lab = Bench(bench)
        lab.carry_out(lab.plan(), 1000)
        (output,) = lab.feed(THREAD, after)
        assert (output.message.verdict, output.message.next_plan_id) == (Checked.UNKNOWN, "")
        assert output.message.held_probability is None or 0.5 < output.message.held_probability < CONFIG.sure


def test_checks_and_the_plans_that_follow_are_repeated_from_a_recording(bench):
    planner = Planner(PlannerConfig(least_probability=0.0, aside_m=0.0))
    steps = Lockstep(planner, rig="golden")
    began = steps.now_ns

    def at(message, late_ms):
        stamp = dataclasses.replace(
            message.stamp, capture_left_ns=began + late_ms * MS, capture_right_ns=began + late_ms * MS
        )
        return Output(THREAD, dataclasses.replace(message, stamp=stamp))

    state = RobotState("psm1", began, RobotMode.IDLE, psm.forward(JOINTS), JOINTS, 0.0, BASE, "")
    steps.tell([Output(ROBOT_STATE, state)], "psm1")
    steps.tell([at(told(bench), 0)])
    goal = bench.goal(s=0.5, policy=Policy.DIRECT)
    header = dataclasses.replace(goal.header, deadline_ns=began + 10**9)
    steps.command(GOAL, dataclasses.replace(goal, header=header))
    plan: GraspPlan = steps.last[PLAN]
    lifted = psm.inverse(compose(inverse(BASE), plan.waypoints[-1].T_camera_tool)[None]).joints[0]
    steps.tell([Output(ROBOT_STATE, dataclasses.replace(state, T_base_tool=psm.forward(lifted)))], "psm1")
    for kind in (ExecutionKind.ACCEPTED, ExecutionKind.FINISHED):
        steps.tell([Output(EXECUTION, ExecutionEvent(plan.plan_id, "psm1", began, kind, None, "", ""))], "psm1")
    steps.tell([at(told(bench), 500)])
    assert steps.last[CHECK].verdict is Checked.MISSED
    made = list(replay(lambda: Planner(PlannerConfig(least_probability=0.0, aside_m=0.0)), steps.entries))
    assert [topic_of(one.key) for one in made] == [PLAN, CHECK, PLAN]
    assert all(one.same for one in made)
    assert decode(GraspCheck, made[1].then).next_plan_id == decode(GraspPlan, made[2].then).plan_id
