"""The instrument against thread outside of the grasp: by brute force, and on threads that are in its way."""

import dataclasses

import numpy as np
import pytest

from agents.planner.config import PlannerConfig
from agents.planner.curve import curve_of
from agents.planner.entanglement import thread_clearance
from agents.planner.instrument import Capsules, clearances
from agents.planner.plan import plan_grasp
from schemas.messages import Phase, Policy, Status, Waypoint
from shared.kinematics.psm import FINGER_M

CONFIG = PlannerConfig()


def test_clearances_are_those_of_a_brute_force():
    rng = np.random.default_rng(1)
    capsules = Capsules(rng.normal(size=(3, 4, 3)), rng.normal(size=(3, 4, 3)), rng.uniform(0, 0.3, 4))
    points = rng.normal(size=(20, 3))
    share = np.linspace(0, 1, 4001)[:, None]
    for k in range(3):
        for n in range(20):
            lines = [capsules.start[k, c] + share * (capsules.end[k, c] - capsules.start[k, c]) for c in range(4)]
            off = [
                np.linalg.norm(line - points[n], axis=1).min() - r
                for line, r in zip(lines, capsules.radius_m, strict=True)
            ]
            assert clearances(capsules, points)[k, n] == pytest.approx(min(off), abs=1e-3)


PIN_Z_MM, WIDE = 80.0, np.radians(60.0)
"""Of a tool that hangs straight down from its base: wrist and shaft are before the pin, fingers behind it."""
WAY = (
    (0.0, WIDE, Phase.APPROACH),
    (10.0, WIDE, Phase.APPROACH),
    (10.0, 0.3, Phase.CAPTURE),
    (20.0, 0.3, Phase.SLIDE),
    (20.0, 0.0, Phase.GRASP),
    (30.0, 0.0, Phase.RETREAT),
)
"""Where the tool is along x, in mm, the jaw, and the phase: sideways all the way, so that each x is in one phase."""


def on_the_way(bench, *corners):
    """How the instrument stands to a thread on that way; what is between the jaws is the thread's beginning."""
    waypoints = []
    for x_mm, jaw_rad, phase in WAY:
        T = np.eye(4)
        T[:3, 3] = 1e-3 * np.array([x_mm, 0.0, PIN_Z_MM])
        waypoints.append(Waypoint(T, jaw_rad, phase, 0.0))
    base = np.eye(4)
    base[:3, 3] = (0.015, 0.0, -0.2)
    return thread_clearance(curve_of(bench.polyline(*corners)), waypoints, base, CONFIG)


def clearance_mm(found):
    """Of a thread that is there."""
    assert found.clearance_m is not None
    return 1e3 * found.clearance_m


PHASES = ((5.0, Phase.APPROACH), (15.0, Phase.SLIDE), (25.0, Phase.RETREAT))
SHAFT, WRIST, CLOSED_FINGERS = (40.0, 4.2), (76.5, 3.5), (88.0, 1.0)
"""Where along the tool, and how thick it is there, in mm."""


@pytest.mark.parametrize(
    ("x_mm", "phase", "z_mm", "radius_mm"),
    [(*moment, *part) for moment in PHASES for part in (SHAFT, WRIST)] + [(*PHASES[2], *CLOSED_FINGERS)],
)
def test_shaft_wrist_and_fingers_are_swept_before_during_and_after_the_grasp(bench, x_mm, phase, z_mm, radius_mm):
    ends_mm = radius_mm + 0.2 + 2.0
    before = on_the_way(bench, (x_mm, 150.0, z_mm), (x_mm, 40.0, z_mm), (x_mm, ends_mm, z_mm))
    across = on_the_way(bench, (x_mm, 150.0, z_mm), (x_mm, 40.0, z_mm), (x_mm, -ends_mm, z_mm))
    # shaft and wrist lean a little in the middle of the way, for the shaft goes through the base
    assert clearance_mm(before) == pytest.approx(2.0, abs=0.1)
    assert (before.phase, before.obstructed) == (phase, "")
    assert across.obstructed.startswith("the instrument touches the thread at s = 0.9")
    assert f", outside of the grasp, in the phase {phase.name.lower()}: " in across.obstructed


def test_open_fingers_are_where_they_reach_and_closed_ones_no_longer(bench):
    out = np.array([np.sin(0.5 * WIDE), np.cos(0.5 * WIDE)])
    y_mm, z_mm = (1e3 * FINGER_M + 1.0 + 0.2 + 2.0) * out + (0.0, PIN_Z_MM)
    opened, closed = (on_the_way(bench, (x, 150.0, 150.0), (x, y_mm, z_mm)) for x in (5.0, 25.0))
    assert clearance_mm(opened) == pytest.approx(2.0, abs=0.01)
    assert clearance_mm(closed) > 4


def test_thread_counts_from_5_mm_along_it_from_the_jaws_on(bench):
    T = np.eye(4)
    T[:3, 3] = (0.0, 0.0, 1e-3 * PIN_Z_MM)
    waypoints = [Waypoint(T, 0.0, Phase.GRASP, 0.5)] * 2
    base = np.eye(4)
    base[:3, 3] = (0.0, 0.0, -0.2)
    found = thread_clearance(curve_of(bench.straight((-40, 0, 86), (40, 0, 86))), waypoints, base, CONFIG)
    assert clearance_mm(found) == pytest.approx(5.0 - 1.0 - 0.2, abs=0.25)
    assert found.s is not None
    assert abs(found.s - 0.5) * 80 == pytest.approx(5.0, abs=0.25)


def known(thread, sigma_mm=0.2):
    covariance = np.tile(np.eye(3) * sigma_mm**2, (5, 1, 1))
    return dataclasses.replace(thread, posterior_s=np.linspace(0, 1, 5), posterior_covariance=covariance)


def stands(plan):
    """How a plan stands to the rest of the thread."""
    assert plan.thread is not None
    return plan.thread


def under_a_strand(bench, base_camera):
    """Thread that comes back over itself, 14 mm nearer to the camera, where the wrist has to be."""
    over = bench.polyline((-30, 0, 80), (30, 0, 80), (30, 0, 66), (-30, 0, 66))
    plan = plan_grasp(bench.goal(s=0.22, policy=Policy.DIRECT), known(over), bench.arm(base_camera), CONFIG)
    assert plan.status is Status.OK, plan.reason
    return plan


def test_an_approach_that_keeps_clear_of_the_thread_is_taken_and_where_there_is_none_the_plan_says_so(bench):
    straight = plan_grasp(bench.goal(s=0.5), known(bench.straight()), bench.arm(), CONFIG)
    assert (straight.status, straight.policy_model) == (Status.OK, "geometric")
    assert stands(straight).obstructed == ""
    assert (stands(straight).clearance_m or 0.0) > CONFIG.thread_clear_m
    assert stands(under_a_strand(bench, (0.05, -0.1, 0))).obstructed == ""
    found = stands(under_a_strand(bench, (0, 0, 0)))
    assert "touches the thread" in found.obstructed
    assert clearance_mm(found) < 0
    assert (found.s or 0.0) > 0.5


def beside_strands(bench, *sides):
    """A plan with strands of the thread 9 mm beside the jaws, where the wrist comes to be, as far as one aside."""
    over = [(x, 9.0 * side, 73) for side in sides for x in ((30, -30) if side == sides[0] else (-30, 30))]
    thread = known(bench.polyline((-30, 0, 88), (30, 0, 88), *over))
    s = 30.0 / (1e3 * curve_of(thread).length_m)
    plan = plan_grasp(bench.goal(s=s, policy=Policy.DIRECT), thread, bench.arm((0.0, 0.0, -0.1)), CONFIG)
    assert plan.status is Status.OK, plan.reason
    assert stands(plan).obstructed == ""
    return [waypoint.T_camera_tool for waypoint in plan.waypoints if waypoint.phase is Phase.RETREAT]


def test_the_jaws_go_to_the_side_that_is_clear_of_the_thread_and_where_none_is_they_only_lift(bench):
    for side in (1, -1):
        lifted, aside = beside_strands(bench, side)
        assert side * (aside - lifted)[1, 3] < -0.004
    assert len(beside_strands(bench, 1, -1)) == 1


def captured_mm(bench, elsewhere_sigma_mm):
    """Where a plan captures whose goal is in the middle, which cannot be approached; over one side hangs a strand."""
    over = bench.polyline((-30, 0, 80), (30, 0, 80), (30, 0, 66), (9, 0, 66))
    s_goal = 30e-3 / curve_of(over).length_m
    # the goal is in the middle of the first of three spans
    places = np.linspace(0, 1, 401)
    sigma_mm = np.where(places > 1 / 6 - 0.02, 0.2, elsewhere_sigma_mm)
    thread = dataclasses.replace(
        over, posterior_s=places, posterior_covariance=sigma_mm[:, None, None] ** 2 * np.eye(3)
    )
    arm = bench.arm((0, 0, 0), reachable=lambda T: (abs(T[:, 0, 3]) > 0.006) | (T[:, 2, 3] > 0.063))
    plan = plan_grasp(bench.goal(s=s_goal), thread, arm, CONFIG)
    assert plan.status is Status.OK, plan.reason
    return 1e3 * plan.waypoints[1].T_camera_tool[0, 3], stands(plan).obstructed


def test_another_capture_is_taken_where_the_best_is_obstructed_but_none_that_is_much_less_likely(bench):
    x_mm, obstructed = captured_mm(bench, 0.2)
    assert (x_mm < -6, obstructed) == (True, "")
    x_mm, obstructed = captured_mm(bench, 2.0)
    assert x_mm > 6
    assert "touches the thread" in obstructed
