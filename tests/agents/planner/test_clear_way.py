"""Ways of the instrument: clear of thread outside of the grasp, and after the lift sideways, clear of tissue."""

import dataclasses

import numpy as np
import pytest

from agents.planner.config import PlannerConfig
from agents.planner.curve import curve_of
from agents.planner.entanglement import thread_clearance
from schemas.messages import Phase, Status, Waypoint
from shared.kinematics.psm import FINGER_M
from tests.agents.planner import bench

CONFIG = PlannerConfig(least_probability=0.0)
PIN_Z_M = 0.08
"""Of a tool that hangs straight down from its base: wrist and shaft are before the pin, fingers behind it."""
APPROACH, SLIDE, RETREAT = (5.0, Phase.APPROACH), (15.0, Phase.SLIDE), (25.0, Phase.RETREAT)
"""Places along x, in mm, and the phase in which the tool passes: it goes sideways all the way."""
SHAFT, WRIST, CLOSED_FINGERS = (40.0, 4.2), (76.5, 3.5), (88.0, 1.0)
"""Where along the tool, and how thick it is there, in mm."""


def pose(x_m, z_m):
    T = np.eye(4)
    T[0, 3], T[2, 3] = x_m, z_m
    return T


def on_the_way(*corners, beside=None):
    """How the instrument stands to a thread on that way; what is between the jaws is the thread's beginning."""
    stands = (0.0, 1.0, Phase.APPROACH), (0.01, 1.0, Phase.APPROACH), (0.01, 0.3, Phase.CAPTURE)
    stands += (0.02, 0.3, Phase.SLIDE), (0.02, 0.0, Phase.GRASP), (0.03, 0.0, Phase.RETREAT)
    waypoints = [Waypoint(pose(x_m, PIN_Z_M), jaw_rad, phase, 0.0) for x_m, jaw_rad, phase in stands]
    return thread_clearance(curve_of(bench.polyline(*corners)), waypoints, pose(0.015, -0.2), CONFIG, beside=beside)


@pytest.mark.parametrize(
    ("moment", "part"),
    [(moment, part) for moment in (APPROACH, SLIDE, RETREAT) for part in (SHAFT, WRIST)] + [(RETREAT, CLOSED_FINGERS)],
)
def test_shaft_wrist_and_fingers_are_swept_before_during_and_after_the_grasp(moment, part):
    (x_mm, phase), (z_mm, radius_mm) = moment, part
    ends_mm = radius_mm + 0.2 + 2.0
    before, across = (
        on_the_way((x_mm, 150.0, z_mm), (x_mm, 40.0, z_mm), (x_mm, y_mm, z_mm)) for y_mm in (ends_mm, -ends_mm)
    )
    # shaft and wrist lean a little in the middle of the way, for the shaft goes through the base
    assert before.clearance_m == pytest.approx(2e-3, abs=1e-4)
    assert (before.phase, before.obstructed) == (phase, "")
    assert across.obstructed.startswith("the instrument touches the thread at s = 0.9")
    assert f", outside of the grasp, in the phase {phase.name.lower()}: " in across.obstructed


@pytest.mark.parametrize("part", [SHAFT, WRIST])
def test_another_strand_is_kept_clear_of_as_the_thread_is(part):
    x_mm, (z_mm, radius_mm) = RETREAT[0], part
    away = (x_mm, 150.0, z_mm), (x_mm, 60.0, z_mm)
    for y_mm, word in ((radius_mm + 2.2, ""), (-radius_mm, "the instrument touches another strand, in the phase")):
        strand = np.linspace((x_mm, 40.0, z_mm), (x_mm, y_mm, z_mm), 200) * 1e-3
        assert on_the_way(*away, beside=strand).obstructed.startswith(word)
        assert bool(on_the_way(*away, beside=strand).obstructed) == bool(word)


def test_thread_counts_from_5_mm_along_it_from_the_jaws_on():
    waypoints = [Waypoint(pose(0.0, PIN_Z_M), 0.0, Phase.GRASP, 0.5)] * 2
    curve = curve_of(bench.straight((-40, 0, 86), (40, 0, 86)))
    found = thread_clearance(curve, waypoints, pose(0.0, -0.2), CONFIG)
    assert found.clearance_m == pytest.approx(1e-3 * (5.0 - 1.0 - 0.2), abs=2.5e-4)
    assert abs((found.s or 0.0) - 0.5) * 80 == pytest.approx(5.0, abs=0.25)


def ok(plan):
    assert plan.status is Status.OK, plan.reason
    return plan


def under_a_strand(base_camera):
    """Thread that comes back over itself, 14 mm nearer to the camera, where the wrist has to be."""
    over = bench.known(bench.polyline((-30, 0, 80), (30, 0, 80), (30, 0, 66), (-30, 0, 66)), 0.2)
    return ok(bench.direct(0.22, over, bench.arm(base_camera))).thread


def test_an_approach_that_keeps_clear_of_the_thread_is_taken_and_where_there_is_none_the_plan_says_so():
    plan = ok(bench.plan(0.5, bench.known(bench.straight(), 0.2)))
    assert (plan.policy_model, plan.thread.obstructed) == ("geometric", "")
    assert plan.thread.clearance_m > CONFIG.thread_clear_m
    assert under_a_strand((0.05, -0.1, 0)).obstructed == ""
    found = under_a_strand((0, 0, 0))
    assert "touches the thread" in found.obstructed
    assert (found.clearance_m < 0, found.s > 0.5) == (True, True)


def captured_mm(elsewhere_sigma_mm):
    """Where a plan captures whose goal is in the middle, which cannot be approached; over one side hangs a strand."""
    over = bench.polyline((-30, 0, 80), (30, 0, 80), (30, 0, 66), (9, 0, 66))
    # the goal is in the middle of the first of three spans
    places = np.linspace(0, 1, 401)
    sigma_mm = np.where(places > 1 / 6 - 0.02, 0.2, elsewhere_sigma_mm)
    covariance = sigma_mm[:, None, None] ** 2 * np.eye(3)
    thread = dataclasses.replace(over, posterior_s=places, posterior_covariance=covariance)
    arm = bench.arm((0, 0, 0), reachable=lambda T: (abs(T[:, 0, 3]) > 0.006) | (T[:, 2, 3] > 0.063))
    plan = ok(bench.plan(30e-3 / curve_of(over).length_m, thread, arm))
    return 1e3 * plan.waypoints[1].T_camera_tool[0, 3], plan.thread.obstructed


def test_another_capture_is_taken_where_the_best_is_obstructed_but_none_that_is_much_less_likely():
    x_mm, obstructed = captured_mm(0.2)
    assert (x_mm < -6, obstructed) == (True, "")
    x_mm, obstructed = captured_mm(2.0)
    assert (x_mm > 6, "touches the thread" in obstructed) == (True, True)


def planned(config=CONFIG, arm=None, **rest):
    return ok(bench.direct(0.5, bench.bent(deviations_mm=(0.05, 0.05, 1.5)), arm, config, **rest))


def retreats(plan):
    return [waypoint.T_camera_tool for waypoint in plan.waypoints if waypoint.phase is Phase.RETREAT]


def side_mm(plan):
    """How far to the side the jaws go after their lift, in y."""
    lifted, aside = retreats(plan)
    return 1e3 * (aside - lifted)[1, 3]


def test_after_the_lift_the_jaws_go_on_sideways_clear_of_thread_they_do_not_hold():
    plan = planned()
    lifted, aside = retreats(plan)
    by = 1e3 * (aside - lifted)
    np.testing.assert_allclose(by[:3, :3], 0, atol=1e-12)
    assert np.linalg.norm(by[:3, 3]) == pytest.approx(5.0)
    assert abs(by[2, 3]) < 0.5, "in the image, not in depth"
    assert {waypoint.jaw_rad for waypoint in plan.waypoints[-3:]} == {0}
    assert lifted[2, 3] + FINGER_M * lifted[2, 2] <= 0.088 - CONFIG.aside_clear_m + 1e-6
    for config in (dataclasses.replace(CONFIG, policy_model="paper"), dataclasses.replace(CONFIG, aside_m=0.0)):
        assert len(retreats(planned(config))) == 1


def test_the_side_is_one_that_the_arm_reaches_and_where_it_reaches_none_the_lift_is_all():
    for side in (1, -1):
        arm = bench.arm(reachable=lambda T, side=side: side * T[:, 1, 3] < 0.003)
        assert side * side_mm(planned(arm=arm)) < -4
    assert len(retreats(planned(arm=bench.arm(reachable=lambda T: abs(T[:, 1, 3]) < 0.003)))) == 1


def beside_strands(*sides):
    """A plan with strands of the thread 9 mm beside the jaws, where the wrist comes to be."""
    over = [(x, 9.0 * side, 73) for side in sides for x in ((30, -30) if side == sides[0] else (-30, 30))]
    thread = bench.known(bench.polyline((-30, 0, 88), (30, 0, 88), *over), 0.2)
    plan = ok(bench.direct(30e-3 / curve_of(thread).length_m, thread, bench.arm((0.0, 0.0, -0.1))))
    assert plan.thread.obstructed == ""
    return plan


NARROW = dataclasses.replace(CONFIG, depths_m=(0.002,), opens_deg=(30.0,), slides_deg=(20.0,))
"""Jaws that open less than they go to the side."""


def folded(*sides):
    """Tissue 2 mm behind the thread that rises steeply 4 mm beside it, where y has one of these signs."""

    def depth_mm(_, v):
        beyond = np.max([side * (v - 269.5) - 45.0 for side in sides], axis=0)
        return np.clip(90.0 - 0.8 * np.maximum(beyond, 0.0), 76.0, None)

    return planned(NARROW, tissue=bench.tissue(depth_mm))


@pytest.mark.parametrize("in_the_way", [beside_strands, folded])
def test_the_jaws_go_to_the_side_that_is_clear_of_thread_and_tissue_and_where_none_is_they_only_lift(in_the_way):
    for side in (1, -1):
        assert side * side_mm(in_the_way(side)) < 0
    assert len(retreats(in_the_way(1, -1))) == 1


def test_where_tissue_has_to_be_known_it_has_to_be_beside_the_thread_too():
    required = dataclasses.replace(NARROW, tissue_required=True)
    half_known = bench.tissue(90.0, known=lambda _, v: v - 269.5 < 60)
    assert side_mm(planned(required, tissue=half_known)) < 0, "to where the tissue is known"
    assert len(retreats(planned(NARROW, tissue=bench.tissue(90.0)))) == 2
