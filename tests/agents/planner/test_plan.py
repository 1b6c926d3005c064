"""Whole plans: by closed forms on straight threads, each rejection provoked, and any thread and goal survived."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.config import PlannerConfig
from agents.planner.plan import plan_grasp
from schemas.codec import decode, encode
from schemas.messages import GraspPlan, Phase, Policy, Status, ThreadCourse
from tests.agents.planner import bench

UNSURE_NEAR_THE_END = [1.0] * 61 + [0.6] * 39
SHARES = np.linspace(0, 1, 100)


def test_a_direct_grasp_on_a_thread_along_x_has_exactly_the_poses_of_the_closed_form():
    plan = bench.direct()
    assert (plan.plan_id, plan.goal_id, plan.arm, plan.stamp) == ("plan-g1", "g1", "psm1", bench.straight().stamp)
    assert (plan.status, plan.s_goal, plan.s_capture, plan.slide_m, plan.probability) == (Status.OK, 0.5, 0.5, 0, 1)
    assert [(w.phase, round(np.degrees(w.jaw_rad)), w.s) for w in plan.waypoints] == [
        (Phase.APPROACH, 60, None),
        (Phase.APPROACH, 60, 0.5),
        (Phase.CAPTURE, 20, 0.5),
        (Phase.GRASP, 0, 0.5),
        (Phase.RETREAT, 0, None),
    ]
    for waypoint, z in zip(plan.waypoints, (0.0368, 0.0518, 0.0518, 0.0518, 0.0468), strict=True):
        expected = np.eye(4)
        expected[2, 3] = z
        np.testing.assert_allclose(waypoint.T_camera_tool, expected, atol=1e-12)


def test_an_oblique_thread_has_its_jaw_axis_along_it_and_its_fingers_in_the_plane_of_the_viewing_ray():
    start, end = np.array([-15.0, -5, 55]), np.array([20.0, 10, 80])
    tangent, point = (end - start) / np.linalg.norm(end - start), 1e-3 * (start + 0.3 * (end - start))
    T = bench.plan(0.3, bench.straight(start, end)).waypoints[1].T_camera_tool
    approach = point - (point @ tangent) * tangent
    approach /= np.linalg.norm(approach)
    np.testing.assert_allclose(np.abs(T[:3, 0] @ tangent), 1)
    np.testing.assert_allclose(T[:3, 2], approach, atol=1e-9)
    np.testing.assert_allclose(T[:3, 3], point - 0.0082 * approach, atol=1e-9)


def test_where_the_goal_is_uncertain_the_thread_is_captured_where_it_is_known_and_slid_along():
    plan = bench.plan(0.7, bench.straight(confidence=UNSURE_NEAR_THE_END))
    assert plan.s_capture == pytest.approx(60 / 99)
    assert plan.probability == pytest.approx(0.6 * 0.99**9), "with the least confidence on the way"
    assert plan.slide_m == pytest.approx(0.04 * (0.7 - 60 / 99))
    assert (plan.s_goal, plan.policy) == (0.7, Policy.CAPTURE_SLIDE_GRASP)
    phases = [w.phase.value for w in plan.waypoints]
    assert (phases, set(phases)) == (sorted(phases), set(range(1, 1 + Phase.RETREAT.value)))
    slide = [w for w in plan.waypoints if w.phase is Phase.SLIDE]
    np.testing.assert_allclose(np.array([w.s for w in slide]), [*(np.arange(61, 69) / 99), 0.7])
    assert {round(np.degrees(w.jaw_rad)) for w in slide} == {20}
    x = [w.T_camera_tool[0, 3] + 0.0082 * w.T_camera_tool[0, 2] for w in slide]
    np.testing.assert_allclose(x, -0.02 + 0.04 * np.array([w.s for w in slide]), atol=1e-9)


def test_where_a_slide_leaves_too_little_probability_a_less_likely_capture_with_enough_is_taken():
    """From s = 60 / 99 the paper's formula gives 0.99^15 = 0.86, but the thread is known by 0.58 on the way."""
    plan = bench.plan(75 / 99, bench.straight(confidence=[1.0] * 61 + [0.58] * 39))
    assert (plan.s_capture, plan.probability) == pytest.approx((75 / 99, 0.58))


def from_the_left():
    """An arm with room for the approach, 15 mm nearer to the camera, left of the middle alone."""
    return bench.arm((0, 0, -0.01), reachable=lambda T: (T[:, 0, 3] < -0.003) | (T[:, 2, 3] > 0.045))


@pytest.mark.parametrize("hardly", ["known", "seen"])
def test_no_grasp_ends_and_no_slide_leads_where_the_thread_is_hardly_known_or_unseen(hardly):
    def thread(low, high):
        if hardly == "seen":
            return bench.straight(unseen=[(low, high)])
        return bench.straight(confidence=np.where(np.abs(SHARES - (low + high) / 2) < (high - low) / 2, 0.4, 1.0))

    for policy in Policy:
        plan = bench.plan(0.9, thread(0.8, 1.0), policy=policy)
        assert (plan.status, plan.probability, plan.s_goal, plan.waypoints) == (Status.FAILED, 0, 0.9, ())
        assert "unseen" in plan.reason
    assert bench.plan(0.7, view=from_the_left()).status is Status.OK
    plan = bench.plan(0.7, thread(0.45, 0.55), from_the_left())
    assert plan.status is Status.FAILED
    assert "unseen, undecided or hardly known up to the goal" in plan.reason


def with_course(thread, join, between, end=1.0):
    """The thread where it is known so well how its pieces are joined, and whether it ends at its end."""
    joins = np.array([[0.0, 0.0], join, [1.0, 1.0]])
    course = ThreadCourse(joins, np.array([1.0, between, end]), np.array([[0.0, join[0]], [1.0, join[1]]]))
    return dataclasses.replace(thread, course=course)


def test_no_grasp_or_slide_is_where_the_thread_may_lead_elsewhere():
    doubtful = with_course(bench.straight(), (0.45, 0.55), 0.9, end=0.5)
    assert bench.plan(0.5, with_course(bench.straight(), (0.45, 0.55), 0.99, end=0.5)).status is Status.OK
    assert bench.plan(0.5, doubtful).status is Status.FAILED
    # an end that may lead on elsewhere does not speak against what is seen of the thread
    assert bench.plan(0.8, doubtful).s_capture > 0.55
    # a join of one place, and one between two samples
    for join in ((0.51, 0.51), (0.5095, 0.5105)):
        for between, status in ((0.99, Status.OK), (0.6, Status.FAILED)):
            thread = with_course(bench.straight(), join, between)
            assert bench.plan(0.7, thread, from_the_left()).status is status


def test_a_sharp_corner_is_not_slid_around():
    corner = bench.polyline((-10, -10, 60), (10, -10, 60), (10, 10, 60), confidence=[0.9] * 5 + [0.6] * 5)
    plan = bench.plan(0.6, corner)
    assert "turns too sharply" in {a.reason for a in plan.alternatives}
    assert plan.s_capture > 0.5


def test_the_approach_comes_from_the_base_where_the_viewing_ray_runs_along_the_thread_or_is_not_reached():
    plan = bench.plan(0.5, bench.straight((1, 0, 50), (2, 0, 90)), bench.arm(base_camera=(0.1, 0.0, 0.03)))
    assert plan.waypoints[0].T_camera_tool[0, 2] < -0.9, "the fingers point away from the base, towards -x"
    plan = bench.plan(view=bench.arm((0.0, -0.1, 0.0), reachable=lambda T: T[:, 1, 2] > 0.5))
    expected = np.array([0, 0.1, 0.06]) / np.hypot(0.1, 0.06)
    np.testing.assert_allclose(plan.waypoints[0].T_camera_tool[:3, 2], expected, atol=1e-9)


def test_a_capture_out_of_reach_or_hidden_gives_way_to_another_and_is_told_of():
    confidence = [1.0] * 40 + [0.6] * 30 + [0.9] * 30
    plan = bench.plan(0.55, bench.straight(confidence=confidence), bench.arm(reachable=lambda T: T[:, 0, 3] > -0.003))
    assert plan.s_capture == pytest.approx(70 / 99)
    assert {a.reason for a in plan.alternatives} == {"unreachable", "another capture is better"}
    thread = bench.straight(unseen=[(0.4, 0.6)])
    plan = bench.plan(0.39, thread)
    assert plan.s_capture == 0.39
    assert {a.reason for a in plan.alternatives} == {"unseen", "another capture is better"}
    assert bench.direct(0.5, thread).reason == "the thread cannot be grasped directly at s = 0.500: unseen"


def test_nothing_is_captured_at_a_crossing_or_slid_across_it():
    """The strands meet at s = 20/105 and 90/105; open jaws reach 8.2 mm · tan 30° = 4.73 mm to each side."""
    loop = bench.polyline((-20, 0, 60), (20, 0, 60), (20, 15, 60), (0, 15, 60), (0, -15, 60))
    assert abs(20 - 105 * bench.plan(16 / 105, loop).s_capture) > 4.7
    assert "another strand" in bench.plan(20 / 105, loop).reason
    assert bench.direct(16 / 105, loop).reason.endswith("directly at s = 0.152: another strand beside it")
    # all of the right side is known well, yet it lies beyond the crossing
    s = np.linspace(0, 1, 400)
    unsure = dataclasses.replace(loop, confidence_s=s, confidence=np.where(s < 0.3, 0.5, 1))
    blocked = bench.plan(16 / 105, unsure)
    assert blocked.status is Status.FAILED
    assert "and 0.50 is asked for" in blocked.reason
    assert "another strand on the way to the goal" in {a.reason for a in blocked.alternatives}


@pytest.mark.parametrize(
    ("thread", "arm", "said"),
    [
        (bench.failed("it was out of focus"), bench.arm(), "there is no thread: it was out of focus"),
        (bench.straight(), bench.arm(reachable=lambda T: np.zeros(len(T), bool)), "100 unreachable"),
        (bench.straight((-20, 40, 60), (20, 40, 60)), bench.arm(), "100 unseen"),
        (bench.straight(confidence=[0.1, 0.2]), bench.arm(), "100 unseen, undecided or hardly known"),
        (bench.straight((0, 0, 50), (0.1, 0, 90)), bench.arm((0, 0, -0.1)), "100 thread along the approach"),
    ],
)
def test_each_rejection_says_why(thread, arm, said):
    plan = bench.plan(0.9, thread, arm)
    assert (plan.status, plan.waypoints, plan.s_capture, plan.slide_m) == (Status.FAILED, (), None, 0)
    assert said in plan.reason


def test_the_unit_of_the_calibration_makes_no_difference():
    thread = bench.straight(confidence=UNSURE_NEAR_THE_END)
    one, other = (bench.plan(0.7, each) for each in (thread, bench.in_unit(thread, 1.0)))
    assert other.slide_m == pytest.approx(one.slide_m)
    for a, b in zip(one.waypoints, other.waypoints, strict=True):
        np.testing.assert_allclose(a.T_camera_tool, b.T_camera_tool, atol=1e-9)


COORDINATE = st.floats(-40, 40)
THREADS = st.fixed_dictionaries(
    {
        "control_points": st.lists(st.tuples(COORDINATE, COORDINATE, st.floats(-20, 150)), min_size=4, max_size=9),
        "confidence": st.lists(st.floats(0, 1), min_size=1, max_size=6),
        "unseen": st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), max_size=2),
        "degree": st.integers(1, 3),
    }
)
ANY_NUMBER = st.floats(allow_nan=False, allow_infinity=False)
GOALS = st.one_of(
    st.fixed_dictionaries({"s": st.floats(0, 1)}),
    st.fixed_dictionaries({"pixel": st.tuples(ANY_NUMBER, ANY_NUMBER)}),
    st.fixed_dictionaries({"point_camera": st.tuples(ANY_NUMBER, ANY_NUMBER, ANY_NUMBER)}),
    st.fixed_dictionaries({"pixel": st.tuples(st.floats(0, 960), st.floats(0, 540))}),
)


@pytest.mark.slow
@settings(max_examples=20)
@given(THREADS, GOALS, st.sampled_from(Policy), st.floats(-0.1, 0.1), st.floats(0, 0.6))
def test_any_thread_and_goal_end_in_a_plan_or_a_reason_that_can_be_sent(thread, goal, policy, base, reach):
    arm = bench.arm((base, -base, -0.05), reachable=lambda T: np.linalg.norm(T[:, :3, 3], axis=1) < reach)
    config = PlannerConfig(least_probability=0.05, goal_within_px=200)
    request, reconstruction = bench.goal(**goal, policy=policy), bench.thread(**thread)
    plan = plan_grasp(request, reconstruction, arm, config)
    assert encode(plan_grasp(request, reconstruction, arm, config)) == encode(plan), "the same again"
    assert encode(decode(GraspPlan, encode(plan))) == encode(plan)
    for waypoint in plan.waypoints:
        assert np.linalg.norm(waypoint.T_camera_tool[:3, 3]) < reach


@settings(max_examples=20)
@given(st.lists(st.tuples(*[ANY_NUMBER] * 3), min_size=4, max_size=6), st.floats(1e-300, 1e300), GOALS)
def test_absurd_numbers_end_in_a_reason(control_points, metres_per_unit, goal):
    camera = dataclasses.replace(bench.CAMERA, metres_per_unit=metres_per_unit)
    thread = bench.thread(control_points, camera=camera)
    plan = plan_grasp(bench.goal(**goal), thread, bench.arm(), PlannerConfig())
    assert decode(GraspPlan, encode(plan)).status is plan.status
