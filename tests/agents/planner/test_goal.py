"""Goals by s, by pixel, by point and from the swage of a needle; and grasps beside a needle."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, curve_of
from agents.planner.goal import goal_on_thread
from agents.planner.needle import needle_around
from agents.planner.plan import plan_grasp
from schemas.codec import encode
from schemas.messages import NeedlePose, Status
from tests.agents.planner import bench

CONFIG = PlannerConfig()
RADIUS_MM = 6.0


@pytest.fixture(scope="session")
def wavy():
    x = np.linspace(-25, 25, 12)
    return curve_of(bench.thread(np.column_stack((x, 8 * np.sin(x / 6), 70 + 10 * np.cos(x / 9)))))


@given(st.floats(0, 1))
def test_a_goal_by_s_by_its_pixel_and_by_its_point_is_that_place(wavy, s):
    x, y, z = point = wavy.points(np.array([s]))[0]
    pixel = 1000 * x / z + bench.CAMERA.cx_px, 1000 * y / z + bench.CAMERA.cy_px
    assert goal_on_thread(bench.goal(s=s), wavy, CONFIG) == s
    assert goal_on_thread(bench.goal(pixel=pixel), wavy, CONFIG) == pytest.approx(s, abs=1e-4)
    assert goal_on_thread(bench.goal(point_camera=point), wavy, CONFIG) == pytest.approx(s, abs=1e-4)


def test_a_goal_beside_the_thread_is_its_foot_and_farther_off_it_is_rejected_with_the_distance():
    def found(thread=None, **goal):
        return goal_on_thread(bench.goal(**goal), curve_of(thread or bench.straight()), CONFIG)

    for off in (-0.99, 0.99):
        assert found(pixel=(579.5, 269.5 + 20 * off)) == pytest.approx(0.65)
        assert found(point_camera=(0.01, 0.005 * off, 0.06)) == pytest.approx(0.75)
    assert found(point_camera=(0.023, 0, 0.06)) == 1
    with pytest.raises(NoGraspError, match=r"pixel \(480, 310\) is 40 px off the thread, and at most 20 px"):
        found(pixel=(479.5, 309.5))
    with pytest.raises(NoGraspError, match=r"7\.0 mm off the thread, and at most 5\.0 mm"):
        found(point_camera=(0, 0.007, 0.06))
    with pytest.raises(NoGraspError, match=r"10\.0 mm off"):
        found(point_camera=(0.03, 0, 0.06))
    with pytest.raises(NoGraspError, match="off the thread"):
        found(bench.straight((-20, 0, -60), (20, 0, -60)), pixel=(479.5, 269.5))


def needle(thread, swage_mm, y_mm=0.0, z_mm=60.0, seen=(True, True)):
    """Half a circle in a plane across the view, left of its swage, which lies at so much along x."""
    T = np.eye(4)
    T[:3, 3] = swage_mm - RADIUS_MM, y_mm, z_mm
    sure, covariance = (0.98, 3.0, 0.2), np.diag([0.01] * 3 + [0.0] * 5)
    return NeedlePose(
        thread.stamp, thread.camera, Status.OK, "", T, RADIUS_MM, np.pi, covariance, np.array(seen), *sure
    )


def beside(thread, *swage_mm, **rest):
    """What a planner makes of it."""
    return needle_around(needle(thread, *swage_mm, **rest), thread, bench.CAPTURED_NS)


def test_what_was_seen_with_another_calibration_or_long_ago_or_is_not_known_is_no_needle():
    thread = bench.straight()
    pose = needle(thread, 20.0)
    other = dataclasses.replace(pose, stamp=dataclasses.replace(pose.stamp, calibration_id="other"))
    lost = dataclasses.replace(pose, status=Status.FAILED, reason="hidden", T_camera_needle=None)
    for useless in (other, lost, None):
        assert needle_around(useless, thread, bench.CAPTURED_NS) is None
    assert needle_around(pose, thread, bench.CAPTURED_NS + 4 * 10**9) is None
    assert needle_around(pose, thread, bench.CAPTURED_NS + 2 * 10**9) is not None


def test_thread_at_a_needle_is_not_captured_and_an_instrument_that_cannot_keep_clear_of_it_says_so():
    thread = bench.straight()
    assert bench.direct(0.97).status is Status.OK
    refused = bench.direct(0.97, needle=beside(thread, 20.0))
    assert refused.status is Status.FAILED
    assert refused.reason.endswith("the needle beside it")
    assert encode(bench.direct(0.3)) == encode(bench.direct(0.3, needle=beside(thread, 20.0))), "farther from it"
    # between the camera and the thread, where the shaft has to pass
    plan = bench.direct(0.5, needle=beside(thread, RADIUS_MM, -RADIUS_MM, 40))
    assert "the needle may be, in the phase" in plan.thread.obstructed


def test_a_goal_is_so_much_thread_from_the_swage():
    # 40 mm along x, from -20 to 20 mm, whichever of its ends comes first
    for thread in (bench.straight(), bench.straight((20, 0, 60), (-20, 0, 60))):
        curve = curve_of(thread)
        for swage_mm, from_swage_mm, x_mm in (
            (20.0, 0.0, 20.0),
            (20.0, 12.0, 8.0),
            (22.0, 12.0, 10.0),
            (18.0, 12.0, 6.0),
        ):
            goal = bench.goal(from_swage_m=1e-3 * from_swage_mm)
            s = goal_on_thread(goal, curve, CONFIG, beside(thread, swage_mm))
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
def test_a_goal_from_a_swage_that_nobody_knows_or_past_the_thread_is_refused(swage_mm, seen, from_swage_mm, why):
    thread, goal = bench.straight(), bench.goal(from_swage_m=1e-3 * from_swage_mm)
    with pytest.raises(NoGraspError, match=why):
        goal_on_thread(goal, curve_of(thread), CONFIG, beside(thread, swage_mm, seen=seen))
    assert "needs the needle, and none is known" in plan_grasp(goal, thread, bench.arm(), CONFIG).reason
