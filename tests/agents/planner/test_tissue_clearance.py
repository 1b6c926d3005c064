"""Plans against tissue: what is said of it, what is refused and why, and which other way is taken."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.config import PlannerConfig
from agents.planner.policy import Against
from agents.planner.tissue_clearance import SeenTissue
from schemas.messages import Phase, Policy, Status
from tests.agents.planner import bench

CONFIG = PlannerConfig()
COARSE = PlannerConfig(samples=20)


def test_a_plan_tells_its_least_clearance_with_deviation_and_place():
    """A thread 1 mm before a wall: the closed fingertips end 2 mm beyond it, and so 1 mm in the wall."""
    told = bench.direct(tissue=bench.tissue(61.0, deviation_mm=0.2)).tissue
    assert (told.unchecked, told.known_share, told.phase, told.s) == ("", 1, Phase.GRASP, 0.5)
    assert told.clearance_m == pytest.approx(-0.001, abs=2e-6)
    assert told.deviation_m == pytest.approx(0.0002, rel=0.01)
    assert told.place_camera[2] == pytest.approx(0.062)


@pytest.mark.parametrize("policy", Policy)
def test_a_thread_that_lies_inside_the_tissue_is_refused_with_depth_place_and_remedy(policy):
    plan = bench.plan(policy=policy, tissue=bench.tissue(57.0))
    assert plan.status is Status.FAILED
    assert Against.IN_TISSUE.value in plan.reason
    # 3 mm between thread and tissue, and 2 mm that the tips reach beyond the thread
    assert "5.0 mm (± 0.1 mm) into the tissue at s = 0." in plan.reason
    assert "at most 4.0 mm are accepted with 2 deviations" in plan.reason
    assert "lift the thread there" in plan.reason
    assert plan.tissue.clearance_m == pytest.approx(-0.005, abs=5e-5)


def test_how_deep_is_accepted_can_be_set_and_uncertainty_counts():
    deeper = dataclasses.replace(CONFIG, press_m=0.0055)
    careless = dataclasses.replace(deeper, sigmas=1.0)
    unsure = bench.tissue(57.0, deviation_mm=0.4)
    assert bench.direct(config=deeper, tissue=bench.tissue(57.0)).status is Status.OK
    assert bench.direct(config=deeper, tissue=unsure).status is Status.FAILED
    assert bench.direct(config=careless, tissue=unsure).status is Status.OK


@pytest.mark.parametrize("side", [1, -1])
def test_on_a_steep_slope_the_approach_is_tilted_towards_it(side):
    """It rises at 42° to one side of the thread, into the finger that would come down there."""
    slope = bench.tissue(lambda _, v: 60.3 / (1.0 + side * 0.9 * (v - 269.5) / 1000.0))
    straight, above = dataclasses.replace(CONFIG, tilts_deg=()), bench.arm((0.1, 0.0, 0.0))
    assert bench.direct(0.5, None, above, straight, tissue=slope).status is Status.FAILED
    plan = bench.direct(0.5, None, above, tissue=slope)
    approach = plan.waypoints[0].T_camera_tool[:3, 2]
    assert side * approach[1] > 0.2, "more squarely on the slope"
    assert approach[0] == pytest.approx(0, abs=1e-9), "across the thread as before"
    assert plan.tissue.clearance_m - 2 * plan.tissue.deviation_m >= -CONFIG.press_m


def test_without_tissue_or_where_the_viewing_ray_will_do_the_plan_is_as_ever_and_says_what_was_checked():
    for tissue, unchecked, known in (
        (bench.tissue(61.0), "", 1),
        (SeenTissue(None, None, "it is old"), "not checked against tissue: it is old", 0),
    ):
        plan = bench.direct(tissue=tissue)
        assert (plan.tissue.unchecked, plan.tissue.known_share) == (unchecked, known)
        np.testing.assert_allclose(plan.waypoints[0].T_camera_tool[:3, 2], (0, 0, 1), atol=1e-9)


def test_another_place_is_captured_where_tissue_is_in_the_way_of_the_best_or_of_the_slide():
    """The thread is known best left of the goal; there a bump reaches above it, or a ridge on the way to the goal."""
    free = bench.tissue(62.0)
    bump = bench.tissue(lambda u, _: np.where(np.abs(u - 479.5) < 90, 55.0, 62.0))
    thread = bench.straight(confidence=[1.0] * 61 + [0.7] * 39)
    assert bench.plan(0.8, thread, tissue=free).s_capture == pytest.approx(60 / 99)
    plan = bench.plan(0.8, thread, tissue=bump)
    assert plan.s_capture > 0.62
    assert Against.IN_TISSUE.value in {a.reason for a in plan.alternatives}
    ridge = bench.tissue(lambda u, _: np.where(np.abs(u - 600) < 30, 54.0, 62.0))
    thread, config = bench.straight(confidence=[1.0] * 41 + [0.4] * 59), PlannerConfig(least_probability=0.1)
    assert bench.plan(0.9, thread, None, config, tissue=free).s_capture < 0.5
    assert bench.plan(0.9, thread, None, config, tissue=ridge).s_capture > 0.7


def test_where_some_of_the_way_is_unknown_the_plan_says_how_much_and_tissue_can_be_required():
    partly = bench.tissue(61.0, known=lambda _, v: v < 300)
    plan = bench.direct(tissue=partly)
    assert plan.status is Status.OK
    assert 0.2 < plan.tissue.known_share < 0.9
    assert plan.tissue.unchecked.endswith("of the way not checked against tissue: none was measured there")
    elsewhere = bench.direct(tissue=bench.tissue(61.0, known=lambda u, _: u > 800))
    assert elsewhere.tissue.unchecked == "not checked against tissue: none was measured there"
    required = dataclasses.replace(CONFIG, tissue_required=True)
    for tissue, why in ((partly, "tissue_required"), (SeenTissue(None, None, "it is old"), "it is old")):
        plan = bench.direct(config=required, tissue=tissue)
        assert plan.status is Status.FAILED
        assert Against.TISSUE_UNKNOWN.value in plan.reason
        assert why in plan.reason
    assert bench.direct(config=required, tissue=bench.tissue(61.0)).status is Status.OK


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from(Policy), st.booleans())
def test_any_surface_ends_in_a_plan_or_a_reason_that_can_be_sent(seed, policy, required):
    rng = np.random.default_rng(seed)
    tissue = bench.tissue(
        lambda u, _: rng.uniform(40, 90) + rng.normal(0, 3, u.shape),
        known=lambda u, _: rng.random(u.shape) < rng.uniform(0.01, 1),
    )
    if tissue.tissue is None:
        return
    config = dataclasses.replace(COARSE, tissue_required=required)
    thread = bench.straight(confidence=[1.0] * 61 + [0.6] * 39)
    plan = bench.plan(float(rng.random()), thread, None, config, policy, tissue=tissue)
    if plan.status is Status.OK and plan.tissue.clearance_m is not None:
        assert plan.tissue.clearance_m - 2 * plan.tissue.deviation_m >= -config.press_m - 1e-12
