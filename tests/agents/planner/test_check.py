"""Whether a grasp holds the thread, by what two reconstructions show; and what a miss tells."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.check import checked, held_probability
from agents.planner.config import PlannerConfig
from agents.planner.curve import curve_of
from agents.planner.learning import after_miss, next_attempt
from agents.planner.moved import END_M, Motion
from schemas.messages import Checked
from shared.kinematics.psm import FINGER_M
from tests.agents.planner import bench

MM = 1e-3
CONFIG = PlannerConfig(aside_m=0.0)
"""Lifts alone, which leave more untold."""


@pytest.fixture
def plan():
    return bench.direct(0.5, bench.bent(), config=CONFIG)


def after_lift(plan, seen):
    return checked(plan, seen, plan.waypoints[-1].T_camera_tool, CONFIG)


def lifted_by(lifted_mm, all_mm=0.0, width_mm=15.0, **rest):
    """The thread with its middle lifted towards the camera, and all of it farther away."""
    return bench.bent((all_mm - lifted_mm * bench.near_middle(width_mm)) * [0, 0, 1], **rest)


def unsaid(thread):
    """The same thread, without how sure it is."""
    return dataclasses.replace(thread, posterior_s=np.zeros(0), posterior_covariance=np.zeros((0, 3, 3)))


def test_thread_that_moved_with_the_tool_is_held_and_what_is_unsure_is_unknown(plan):
    unsure = (0.05, 0.05, 8.0)
    for seen, verdict in (
        (lifted_by(5.0), Checked.HELD),
        (bench.bent(), Checked.MISSED),
        (lifted_by(0.0, 4.0), Checked.MISSED),
        (lifted_by(5.0, 4.0), Checked.HELD),
        (lifted_by(2.5), Checked.UNKNOWN),
        (lifted_by(5.0, deviations_mm=unsure), Checked.UNKNOWN),
        (unsaid(lifted_by(5.0)), Checked.UNKNOWN),
        (bench.failed(), Checked.UNKNOWN),
    ):
        found = after_lift(plan, seen)
        assert found.verdict is verdict, found.sentence


@pytest.mark.parametrize(
    ("axis", "moved_mm", "why"),
    [(2, 0.0, "by only 0.0 mm"), (2, 1.5, "by only 1.5 mm"), (0, 6.0, "the tool moved along the thread")],
)
def test_a_tool_that_moved_too_little_or_along_the_thread_is_named_for_it(plan, axis, moved_mm, why):
    moved = plan.waypoints[-2].T_camera_tool.copy()
    moved[:3, 3] += moved_mm * MM * moved[:3, axis]
    seen = checked(plan, bench.bent(), moved, CONFIG)
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
    found = Motion(tool, thread, covariance, axes, 0.0, tool_moved, whole, of_whole)
    opens = np.array([0.0, np.cos(turn), np.sin(turn)])
    assert held_probability(found, opens, CONFIG) == pytest.approx(expected, rel=1e-3, abs=1e-9)


def piece(lifted_mm, begins_mm):
    """The thread from so far beside its middle on, which is all that is seen of it; its middle lifted."""
    whole = curve_of(lifted_by(lifted_mm, width_mm=25.0))
    s = np.linspace(0.5 + 1e-3 * begins_mm / whole.length_m, 1.0, 33)
    return bench.known(bench.thread(whole.points(s) / MM), 0.05, 0.05, 0.3)


@pytest.mark.parametrize("begins_mm", [1.0, 6.0])
@pytest.mark.parametrize(("lifted_mm", "verdict"), [(5.0, Checked.HELD), (0.0, Checked.MISSED)])
def test_where_no_thread_is_seen_at_the_jaws_the_thread_beside_them_tells(plan, begins_mm, lifted_mm, verdict):
    seen = after_lift(plan, piece(lifted_mm, begins_mm + END_M / MM))
    assert " mm from the goal, where nothing of it is seen, moved" in seen.sentence
    assert seen.held_probability is not None
    assert (seen.held_probability > 0.5) is (verdict is Checked.HELD)
    assert (seen.verdict is verdict) is (begins_mm == 1.0), seen.sentence


def test_where_nothing_near_the_jaws_is_seen_it_is_unknown_and_what_may_be_held_is_not_let_go(plan):
    seen = after_lift(plan, piece(5.0, 18.0))
    assert (seen.verdict, seen.doubtful) == (Checked.UNKNOWN, False)
    assert "no thread is seen near the jaws after the lift" in seen.sentence
    made_up = dataclasses.replace(piece(5.0, 7.0), hidden=np.array([[0.0, 0.9]]))
    seen = after_lift(plan, made_up)
    assert (seen.verdict, seen.motion) == (Checked.UNKNOWN, None), seen.sentence
    aside = bench.bent(np.where(np.abs(bench.X_MM) < 18, 9.0, 0.0)[:, None] * [0, 1, 0])
    seen = after_lift(plan, aside)
    assert (seen.verdict, seen.doubtful) == (Checked.UNKNOWN, True), seen.sentence
    assert "mm from the way of the tool" in seen.sentence


@pytest.mark.parametrize(("share", "held"), [(1.0, True), (0.7, True), (0.0, False), (-0.5, False)])
def test_limp_thread_that_the_tool_drags_along_as_a_whole_is_likelier_held(plan, share, held):
    """By all of the tool's way at the goal, and by a share of it everywhere else; or by itself, away from it."""
    tool = (plan.waypoints[-1].T_camera_tool - plan.waypoints[-2].T_camera_tool)[:3, 3] / MM
    near = bench.near_middle(25.0) if held else 0.0 * bench.X_MM[:, None]
    seen = after_lift(plan, bench.bent((share + (1 - share) * near) * tool))
    assert seen.held_probability is not None
    # tissue that breathes might carry it so far too
    assert seen.held_probability > 0.5 if held else seen.verdict is Checked.MISSED, seen.sentence


def test_a_miss_moves_the_offset_to_where_the_fingers_would_have_missed_and_the_aim_makes_up_for_it():
    config, thread = PlannerConfig(depths_m=(0.002,)), bench.bent(deviations_mm=(0.05, 0.05, 0.1))
    plan = bench.direct(0.5, thread, config=config)
    known = after_miss(plan, config)
    # fingers that end 2 mm beyond the thread have missed it by being too far back, likelier than by any other way
    assert known.mean_camera @ plan.waypoints[0].T_camera_tool[:3, 2] < -0.1 * MM
    again = bench.direct(0.5, thread, config=config, attempt=next_attempt(plan, Checked.MISSED, config))
    first, second = (p.waypoints[1].T_camera_tool @ [0, 0, FINGER_M - (p.depth_m or 0.0), 1] for p in (plan, again))
    np.testing.assert_allclose((second - first)[:3], -known.mean_camera, atol=1e-9)
    assert (again.attempt, again.attempts, again.plan_id) == (2, 3, "plan-g1-2")


def from_closing_mm(plan):
    return (plan.waypoints[-1].T_camera_tool - plan.waypoints[-3].T_camera_tool)[:3, 3] / MM


@pytest.mark.parametrize(
    ("share", "deeper_mm", "verdict"),
    [(1.0, by, Checked.HELD) for by in (-3.0, 0.0, 3.0)]
    + [(0.0, by, Checked.MISSED) for by in (-3.0, 0.0, 3.0)]
    + [(0.5, 0.0, Checked.UNKNOWN)],
)
def test_after_a_way_to_the_side_it_is_told_even_of_what_is_wrong_in_depth(share, deeper_mm, verdict):
    sideways, unsure = PlannerConfig(least_probability=0.0), (0.05, 0.05, 1.5)
    plan = bench.direct(0.5, bench.bent(deviations_mm=unsure), config=sideways)
    moved = bench.near_middle(15.0) * (share * from_closing_mm(plan) + [0, 0, deeper_mm])
    seen = after_lift(plan, bench.bent(moved, unsure))
    assert seen.verdict is verdict, seen.sentence


@pytest.mark.parametrize("s", [0.005, 0.995])
@pytest.mark.parametrize("held", [True, False])
def test_a_grasp_at_an_end_that_is_seen_too_short_afterwards_is_told_too(s, held):
    def seen_as(control_points):
        return bench.known(bench.thread(control_points), 0.05, 0.05, 0.2)

    points = np.column_stack((0.8 * bench.X_MM, 6 * np.sin(bench.X_MM / 13), np.full(33, 88.0)))
    plan = bench.direct(s, seen_as(points), config=PlannerConfig(least_probability=0.0))
    lift = np.maximum(1 - (np.abs(bench.X_MM - bench.X_MM[round(s * 32)]) / 25) ** 2, 0)[:, None] ** 2
    shorter = 0.97 * (points - points.mean(axis=0)) + points.mean(axis=0)
    seen = after_lift(plan, seen_as(shorter + (lift * from_closing_mm(plan) if held else 0.0)))
    assert seen.verdict is (Checked.HELD if held else Checked.MISSED), seen.sentence
