"""A needle beside the thread: captures keep clear of it, and so does the instrument on its way."""

import dataclasses

import numpy as np
import pytest

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, curve_of
from agents.planner.goal import goal_on_thread
from agents.planner.needle import RADIUS_M, needle_around
from agents.planner.plan import plan_grasp
from schemas.codec import encode
from schemas.messages import NeedlePose, Policy, Status

CONFIG = PlannerConfig()
RADIUS_MM = 6.0


def needle(thread, middle_mm, deviation_mm=0.1, seen=(True, True)):
    """Half a circle in a plane across the view, whose swage lies to the right of its middle."""
    T = np.eye(4)
    T[:3, 3] = middle_mm
    covariance = np.diag([deviation_mm**2] * 3 + [0.0] * 5)
    return NeedlePose(
        thread.stamp, thread.camera, Status.OK, "", T, RADIUS_MM, np.pi, covariance, np.array(seen), 0.98, 3.0, 0.2
    )


def seen_ns(thread):
    return thread.stamp.capture_left_ns


def test_a_needle_reaches_as_far_as_it_is_thick_and_as_it_is_not_known(bench):
    thread = bench.straight()
    around = needle_around(needle(thread, (20.0 - RADIUS_MM, 0, 60)), thread, seen_ns(thread))
    assert around is not None
    np.testing.assert_allclose(around.reach_m, RADIUS_M + 2e-4)
    end, inside = np.array([[0.020, 0, 0.060]]), np.array([[0.014, 0, 0.060]])
    assert around.off(end)[0] == pytest.approx(-RADIUS_M - 2e-4)
    assert around.off(inside)[0] == pytest.approx(1e-3 * RADIUS_MM - RADIUS_M - 2e-4, abs=1e-5)


def test_what_was_seen_with_another_calibration_or_long_ago_or_is_not_known_is_no_needle(bench):
    thread = bench.straight()
    pose = needle(thread, (14.0, 0, 60))
    other = dataclasses.replace(pose, stamp=dataclasses.replace(pose.stamp, calibration_id="other"))
    lost = dataclasses.replace(pose, status=Status.FAILED, reason="hidden", T_camera_needle=None)
    assert needle_around(other, thread, seen_ns(thread)) is None
    assert needle_around(lost, thread, seen_ns(thread)) is None
    assert needle_around(None, thread, seen_ns(thread)) is None
    assert needle_around(pose, thread, seen_ns(thread) + 4 * 10**9) is None
    assert needle_around(pose, thread, seen_ns(thread) + 2 * 10**9) is not None


def test_thread_at_a_needle_is_not_captured_and_the_plan_says_why(bench):
    thread = bench.straight()
    beside = needle_around(needle(thread, (20.0 - RADIUS_MM, 0, 60)), thread, seen_ns(thread))
    goal = bench.goal(s=0.97, policy=Policy.DIRECT)
    assert plan_grasp(goal, thread, bench.arm(), CONFIG).status is Status.OK
    refused = plan_grasp(goal, thread, bench.arm(), CONFIG, needle=beside)
    assert refused.status is Status.FAILED
    assert refused.reason.endswith("the needle beside it")
    # farther from it the thread is grasped as before
    goal = bench.goal(s=0.3, policy=Policy.DIRECT)
    plans = [plan_grasp(goal, thread, bench.arm(), CONFIG, needle=one) for one in (None, beside)]
    assert encode(plans[0]) == encode(plans[1])


def test_an_instrument_that_cannot_keep_clear_of_a_needle_says_so(bench):
    thread = bench.straight()
    # between the camera and the thread, where the shaft has to pass
    before = needle_around(needle(thread, (0.0, -RADIUS_MM, 40)), thread, seen_ns(thread))
    plan = plan_grasp(bench.goal(s=0.5, policy=Policy.DIRECT), thread, bench.arm(), CONFIG, needle=before)
    assert plan.thread is not None
    assert "the needle may be, in the phase" in plan.thread.obstructed


def test_a_goal_is_so_much_thread_from_the_swage(bench):
    # 40 mm along x, from -20 to 20 mm, whichever of its ends comes first
    for thread in (bench.straight(), bench.straight((20, 0, 60), (-20, 0, 60))):
        curve = curve_of(thread)
        for swage_mm, from_swage_mm, x_mm in (
            (20.0, 0.0, 20.0),
            (20.0, 12.0, 8.0),
            (22.0, 12.0, 10.0),
            (18.0, 12.0, 6.0),
        ):
            beside = needle_around(needle(thread, (swage_mm - RADIUS_MM, 0, 60)), thread, seen_ns(thread))
            s = goal_on_thread(bench.goal(from_swage_m=1e-3 * from_swage_mm), curve, CONFIG, beside)
            np.testing.assert_allclose(1e3 * curve.points(np.array([s]))[0], (x_mm, 0, 60), atol=0.05)


@pytest.mark.parametrize(
    ("swage_mm", "seen", "from_swage_mm", "why"),
    [
        (20.0, (False, True), 10.0, "the swage in view of both eyes"),
        (26.0, (True, True), 10.0, "the swage is 6.0 mm off the thread, and at most 5.0 mm"),
        (5.0, (True, True), 10.0, "leads away from the swage on both sides"),
        (22.0, (True, True), 1.0, "known from 2.0 to 42.0 mm from the swage, and the goal is at 1.0 mm"),
        (18.0, (True, True), 50.0, "known from 0.0 to 38.0 mm from the swage, and the goal is at 50.0 mm"),
    ],
)
def test_a_goal_from_a_swage_that_nobody_knows_or_past_the_thread_is_refused(bench, swage_mm, seen, from_swage_mm, why):
    thread = bench.straight()
    beside = needle_around(needle(thread, (swage_mm - RADIUS_MM, 0, 60), seen=seen), thread, seen_ns(thread))
    with pytest.raises(NoGraspError, match=why):
        goal_on_thread(bench.goal(from_swage_m=1e-3 * from_swage_mm), curve_of(thread), CONFIG, beside)


def test_a_goal_from_the_swage_without_a_needle_is_a_plan_that_says_so(bench):
    thread = bench.straight()
    plan = plan_grasp(bench.goal(from_swage_m=0.01), thread, bench.arm(), CONFIG)
    assert plan.status is Status.FAILED
    assert "needs the needle, and none is known" in plan.reason
