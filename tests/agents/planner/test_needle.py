"""A needle beside the thread: captures keep clear of it, and so does the instrument on its way."""

import dataclasses

import numpy as np
import pytest

from agents.planner.config import PlannerConfig
from agents.planner.needle import RADIUS_M, needle_around
from agents.planner.plan import plan_grasp
from schemas.codec import encode
from schemas.messages import NeedlePose, Policy, Status

CONFIG = PlannerConfig()
RADIUS_MM = 6.0


def needle(thread, middle_mm, deviation_mm=0.1):
    """Half a circle in a plane across the view."""
    T = np.eye(4)
    T[:3, 3] = middle_mm
    covariance = np.diag([deviation_mm**2] * 3 + [0.0] * 5)
    return NeedlePose(
        thread.stamp, thread.camera, Status.OK, "", T, RADIUS_MM, np.pi, covariance, np.ones(2, bool), 0.98, 3.0, 0.2
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
