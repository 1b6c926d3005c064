"""Plans against tissue: what is said of it, what is refused and why, and which other way is taken."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.config import PlannerConfig
from agents.planner.plan import plan_grasp
from agents.planner.policy import Against
from agents.planner.standing import SeenTissue
from schemas.codec import decode, encode
from schemas.messages import GraspPlan, Phase, Policy, Status

CONFIG = PlannerConfig()
COARSE = PlannerConfig(samples=20)
UNSURE_NEAR_THE_END = [1.0] * 61 + [0.6] * 39


def planned(bench, tissue, config=CONFIG, s=0.5, policy=Policy.DIRECT, thread=None, arm=None) -> Any:
    """A plan for a thread along x, 60 mm away."""
    thread, arm = thread or bench.straight(), arm or bench.arm()
    plan = plan_grasp(bench.goal(s=s, policy=policy), thread, arm, config, tissue)
    assert decode(GraspPlan, encode(plan)).status is plan.status
    return plan


def test_a_plan_tells_its_least_clearance_with_deviation_and_place(bench):
    """A thread 1 mm before a wall: the closed fingertips end 2 mm beyond it, and so 1 mm in the wall."""
    plan = planned(bench, bench.tissue(61.0, deviation_mm=0.2))
    assert plan.status is Status.OK
    told = plan.tissue
    assert (told.unchecked, told.known_share, told.phase, told.s) == ("", 1, Phase.GRASP, 0.5)
    assert told.clearance_m == pytest.approx(-0.001, abs=2e-6)
    assert told.deviation_m == pytest.approx(0.0002, rel=0.01)
    assert told.place_camera[2] == pytest.approx(0.062)


@pytest.mark.parametrize("policy", Policy)
def test_a_thread_that_lies_inside_the_tissue_is_refused_with_depth_place_and_remedy(bench, policy):
    plan = planned(bench, bench.tissue(57.0), policy=policy)
    assert plan.status is Status.FAILED
    assert Against.IN_TISSUE.value in plan.reason
    # 3 mm between thread and tissue, and 2 mm that the tips reach beyond the thread
    assert "5.0 mm (± 0.1 mm) into the tissue at s = 0." in plan.reason
    assert "at most 4.0 mm are accepted with 2 deviations" in plan.reason
    assert "lift the thread there" in plan.reason
    assert plan.tissue.clearance_m == pytest.approx(-0.005, abs=5e-5)


def test_how_deep_is_accepted_can_be_set_and_uncertainty_counts(bench):
    deeper = dataclasses.replace(CONFIG, press_m=0.0055)
    assert planned(bench, bench.tissue(57.0), deeper).status is Status.OK
    assert planned(bench, bench.tissue(57.0, deviation_mm=0.4), deeper).status is Status.FAILED
    careless = dataclasses.replace(deeper, sigmas=1.0)
    assert planned(bench, bench.tissue(57.0, deviation_mm=0.4), careless).status is Status.OK


@pytest.mark.parametrize("side", [1, -1])
def test_on_a_steep_slope_the_approach_is_tilted_towards_it(bench, side):
    """It rises at 42° to one side of the thread, into the finger that would come down there."""
    slope = bench.tissue(lambda _, v: 60.3 / (1.0 + side * 0.9 * (v - 269.5) / 1000.0))
    straight = dataclasses.replace(CONFIG, tilts_deg=())
    above = bench.arm((0.1, 0.0, 0.0))
    assert planned(bench, slope, straight, arm=above).status is Status.FAILED
    plan = planned(bench, slope, arm=above)
    assert plan.status is Status.OK
    approach = plan.waypoints[0].T_camera_tool[:3, 2]
    assert side * approach[1] > 0.2, "more squarely on the slope"
    assert approach[0] == pytest.approx(0, abs=1e-9), "across the thread as before"
    assert plan.tissue.clearance_m - 2 * plan.tissue.deviation_m >= -CONFIG.press_m


def test_without_tissue_or_where_the_viewing_ray_will_do_the_plan_is_as_ever_and_says_what_was_checked(bench):
    why = "it was seen 5000 ms ago, and at most 3000 ms are accepted"
    for tissue, unchecked, known in (
        (bench.tissue(61.0), "", 1),
        (SeenTissue(None, None, why), f"not checked against tissue: {why}", 0),
    ):
        plan = planned(bench, tissue)
        assert plan.status is Status.OK
        assert (plan.tissue.unchecked, plan.tissue.known_share) == (unchecked, known)
        np.testing.assert_allclose(plan.waypoints[0].T_camera_tool[:3, 2], (0, 0, 1), atol=1e-9)


def test_another_place_is_captured_where_tissue_is_in_the_way_of_the_best(bench):
    """The thread is known best left of the goal; there a bump reaches above it."""
    bump = bench.tissue(lambda u, _: np.where(np.abs(u - 479.5) < 90, 55.0, 62.0))
    thread = bench.straight(confidence=[1.0] * 61 + [0.7] * 39)
    free = planned(bench, bench.tissue(62.0), s=0.8, policy=Policy.CAPTURE_SLIDE_GRASP, thread=thread)
    assert free.s_capture == pytest.approx(60 / 99)
    plan = planned(bench, bump, s=0.8, policy=Policy.CAPTURE_SLIDE_GRASP, thread=thread)
    assert plan.status is Status.OK
    assert plan.s_capture > 0.62
    assert Against.IN_TISSUE.value in {a.reason for a in plan.alternatives}


def test_tissue_on_the_way_to_the_goal_counts(bench):
    ridge = bench.tissue(lambda u, _: np.where(np.abs(u - 600) < 30, 54.0, 62.0))
    thread = bench.straight(confidence=[1.0] * 41 + [0.4] * 59)
    config = dataclasses.replace(CONFIG, least_probability=0.1)
    assert planned(bench, bench.tissue(62.0), config, 0.9, Policy.CAPTURE_SLIDE_GRASP, thread).s_capture < 0.5
    plan = planned(bench, ridge, config, 0.9, Policy.CAPTURE_SLIDE_GRASP, thread)
    assert plan.s_capture > 0.7


def test_where_some_of_the_way_is_unknown_the_plan_says_how_much(bench):
    plan = planned(bench, bench.tissue(61.0, known=lambda _, v: v < 300))
    assert plan.status is Status.OK
    assert 0.2 < plan.tissue.known_share < 0.9
    assert plan.tissue.unchecked.endswith("of the way not checked against tissue: none was measured there")
    elsewhere = planned(bench, bench.tissue(61.0, known=lambda u, _: u > 800))
    assert elsewhere.tissue.unchecked == "not checked against tissue: none was measured there"


@pytest.mark.parametrize("known", [lambda _, v: v < 300, None])
def test_tissue_can_be_required(bench, known):
    required = dataclasses.replace(CONFIG, tissue_required=True)
    tissue = bench.tissue(61.0, known=known) if known else SeenTissue(None, None, "perception has told of none yet")
    plan = planned(bench, tissue, required)
    assert plan.status is Status.FAILED
    assert Against.TISSUE_UNKNOWN.value in plan.reason
    assert ("tissue_required" if known else "perception has told of none yet") in plan.reason
    assert planned(bench, bench.tissue(61.0), required).status is Status.OK


@settings(max_examples=5)
@given(st.floats(50, 66), st.floats(0.2, 6), st.sampled_from(Policy))
def test_what_fits_before_tissue_fits_before_deeper_tissue(bench, depth_mm, deeper_mm, policy):
    near, far = (
        planned(bench, bench.tissue(depth), COARSE, policy=policy) for depth in (depth_mm, depth_mm + deeper_mm)
    )
    assert near.status is Status.FAILED or far.status is Status.OK
    if near.status is Status.OK:
        assert far.tissue.clearance_m > near.tissue.clearance_m


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from(Policy), st.booleans())
def test_any_surface_ends_in_a_plan_or_a_reason_that_can_be_sent(bench, seed, policy, required):
    rng = np.random.default_rng(seed)
    tissue = bench.tissue(
        lambda u, _: rng.uniform(40, 90) + rng.normal(0, 3, u.shape),
        known=lambda u, _: rng.random(u.shape) < rng.uniform(0.01, 1),
    )
    config = dataclasses.replace(COARSE, tissue_required=required)
    if tissue.tissue is None:
        return
    thread = bench.straight(confidence=UNSURE_NEAR_THE_END)
    plan = planned(bench, tissue, config, s=float(rng.random()), policy=policy, thread=thread)
    assert encode(decode(GraspPlan, encode(plan))) == encode(plan)
    if plan.status is Status.OK and plan.tissue.clearance_m is not None:
        assert plan.tissue.clearance_m - 2 * plan.tissue.deviation_m >= -config.press_m - 1e-12
