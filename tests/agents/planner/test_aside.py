"""A plan goes on sideways after its lift, so that the check decides whether the thread is held."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.planner.check import checked
from agents.planner.config import PlannerConfig
from agents.planner.plan import plan_grasp
from schemas.messages import Checked, Phase, Policy
from shared.kinematics.psm import FINGER_M

MM = 1e-3
CONFIG = PlannerConfig(least_probability=0.0)
X = np.linspace(-40, 40, 33)


def told(bench, depth_sigma_mm, moved_mm=(0.0, 0.0, 0.0), deeper_mm=0.0):
    """A bent thread whose middle has moved by so much, and its whole reconstruction near there by more, in depth."""
    near = np.maximum(1 - (X / 15) ** 2, 0)[:, None] ** 2
    at = np.column_stack((X, 6 * np.sin(X / 13), np.full(len(X), 88.0)))
    thread = bench.thread(at + near * moved_mm + near * [0, 0, deeper_mm])
    covariance = np.tile(np.diag([0.05, 0.05, depth_sigma_mm]) ** 2, (9, 1, 1))
    return dataclasses.replace(thread, posterior_s=np.linspace(0, 1, 9), posterior_covariance=covariance)


def planned(bench, depth_sigma_mm, config=CONFIG, **arm):
    goal = bench.goal(s=0.5, policy=Policy.DIRECT)
    return plan_grasp(goal, told(bench, depth_sigma_mm), bench.arm(**arm), config)


def retreats(plan):
    return [waypoint for waypoint in plan.waypoints if waypoint.phase is Phase.RETREAT]


def moved_mm(plan):
    """From closing to the end."""
    grasped = next(w.T_camera_tool for w in plan.waypoints if w.phase is Phase.GRASP)
    return (plan.waypoints[-1].T_camera_tool - grasped)[:3, 3] / MM


def test_after_the_lift_the_jaws_go_on_sideways_clear_of_thread_they_do_not_hold(bench):
    plan = planned(bench, 1.5)
    lifted, aside = retreats(plan)
    by = (aside.T_camera_tool - lifted.T_camera_tool) / MM
    np.testing.assert_allclose(by[:3, :3], 0, atol=1e-12)
    assert np.linalg.norm(by[:3, 3]) == pytest.approx(5.0)
    assert abs(by[2, 3]) < 0.5, "in the image, not in depth"
    assert aside.jaw_rad == lifted.jaw_rad == 0
    tips_m = lifted.T_camera_tool[2, 3] + FINGER_M * lifted.T_camera_tool[2, 2]
    assert tips_m <= 0.088 - CONFIG.aside_clear_m + 1e-6


@pytest.mark.parametrize("deeper_mm", [-3.0, 0.0, 3.0])
@pytest.mark.parametrize(("share", "verdict"), [(1.0, Checked.HELD), (0.0, Checked.MISSED)])
def test_then_the_check_decides_even_of_reconstructions_that_are_wrong_in_depth(bench, share, verdict, deeper_mm):
    plan = planned(bench, 1.5)
    after = told(bench, 1.5, share * moved_mm(plan), deeper_mm)
    seen = checked(plan, after, plan.waypoints[-1].T_camera_tool, CONFIG)
    assert seen.verdict is verdict, seen.sentence


def test_thread_that_followed_half_of_the_way_is_neither(bench):
    plan = planned(bench, 1.5)
    seen = checked(plan, told(bench, 1.5, 0.5 * moved_mm(plan)), plan.waypoints[-1].T_camera_tool, CONFIG)
    assert seen.verdict is Checked.UNKNOWN, seen.sentence


def test_the_side_is_one_that_the_arm_reaches_and_where_it_reaches_none_the_lift_is_all(bench):
    ends = {}
    for side in (1, -1):
        ends[side] = moved_mm(planned(bench, 1.5, reachable=lambda T, side=side: side * T[:, 1, 3] < 0.003))
        assert side * ends[side][1] < 0
    assert np.linalg.norm(ends[1] - ends[-1]) == pytest.approx(10.0)
    nowhere = planned(bench, 1.5, reachable=lambda T: abs(T[:, 1, 3]) < 0.003)
    assert len(retreats(nowhere)) == 1


NARROW = dataclasses.replace(CONFIG, depths_m=(0.002,), opens_deg=(30.0,), slides_deg=(20.0,))
"""Jaws that open less than they go to the side."""


def folded(bench, *sides):
    """Tissue 2 mm behind the thread that rises steeply 4 mm beside it, where y has one of these signs."""

    def depth_mm(_, v):
        beyond = np.max([side * (v - 269.5) - 45.0 for side in sides], axis=0)
        return np.clip(90.0 - 0.8 * np.maximum(beyond, 0.0), 76.0, None)

    return bench.tissue(depth_mm)


def with_tissue(bench, tissue, config=NARROW) -> Any:
    return plan_grasp(bench.goal(s=0.5, policy=Policy.DIRECT), told(bench, 1.5), bench.arm(), config, tissue)


def test_jaws_are_not_dragged_through_tissue_but_go_to_the_other_side_or_only_lift(bench):
    for side in (1, -1):
        plan = with_tissue(bench, folded(bench, side))
        assert len(retreats(plan)) == 2, plan.reason
        assert side * moved_mm(plan)[1] < 0, "away from the fold"
    assert len(retreats(with_tissue(bench, folded(bench, 1, -1)))) == 1
    assert len(retreats(with_tissue(bench, bench.tissue(90.0)))) == 2


def test_where_tissue_has_to_be_known_it_has_to_be_beside_the_thread_too(bench):
    required = dataclasses.replace(NARROW, tissue_required=True)
    plan = with_tissue(bench, bench.tissue(90.0, known=lambda _, v: v - 269.5 < 60), required)
    assert len(retreats(plan)) == 2, plan.reason
    assert moved_mm(plan)[1] < 0, "to where the tissue is known"


def test_the_policy_of_the_paper_and_an_aside_of_nothing_lift_only(bench):
    for config in (dataclasses.replace(CONFIG, policy_model="paper"), dataclasses.replace(CONFIG, aside_m=0.0)):
        assert len(retreats(planned(bench, 1.5, config))) == 1


@pytest.mark.parametrize("s", [0.005, 0.995])
@pytest.mark.parametrize("held", [True, False])
def test_a_grasp_at_an_end_that_is_seen_too_short_afterwards_is_told_too(bench, s, held):
    points = np.column_stack((0.8 * X, 6 * np.sin(X / 13), np.full(len(X), 88.0)))
    covariance = np.tile(np.diag([0.05, 0.05, 0.2]) ** 2, (9, 1, 1))

    def seen_as(control_points):
        thread = bench.thread(control_points)
        return dataclasses.replace(thread, posterior_s=np.linspace(0, 1, 9), posterior_covariance=covariance)

    plan = plan_grasp(bench.goal(s=s, policy=Policy.DIRECT), seen_as(points), bench.arm(), CONFIG)
    lifted = np.maximum(1 - (np.abs(X - X[round(s * 32)]) / 25) ** 2, 0)[:, None] ** 2 * moved_mm(plan)
    after = seen_as(0.97 * (points - points.mean(axis=0)) + points.mean(axis=0) + (lifted if held else 0.0))
    seen = checked(plan, after, plan.waypoints[-1].T_camera_tool, CONFIG)
    assert seen.verdict is (Checked.HELD if held else Checked.MISSED), seen.sentence
