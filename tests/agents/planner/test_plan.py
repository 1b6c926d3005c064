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

CONFIG = PlannerConfig()
UNSURE_NEAR_THE_END = [1.0] * 61 + [0.6] * 39


def phases(plan, phase):
    return [w for w in plan.waypoints if w.phase is phase]


def test_a_direct_grasp_on_a_thread_along_x_has_exactly_the_poses_of_the_closed_form(bench):
    plan = plan_grasp(bench.goal(s=0.5, policy=Policy.DIRECT), bench.straight(), bench.arm(), CONFIG)
    assert (plan.status, plan.s_goal, plan.s_capture, plan.slide_m, plan.probability) == (Status.OK, 0.5, 0.5, 0, 1)
    told = [(w.phase, round(np.degrees(w.jaw_rad)), w.s) for w in plan.waypoints]
    assert told == [
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


def test_an_oblique_thread_has_its_jaw_axis_along_it_and_its_fingers_in_the_plane_of_the_viewing_ray(bench):
    start, end = np.array([-15.0, -5, 55]), np.array([20.0, 10, 80])
    tangent = (end - start) / np.linalg.norm(end - start)
    plan = plan_grasp(bench.goal(s=0.3), bench.straight(start, end), bench.arm(), CONFIG)
    R, origin = plan.waypoints[1].T_camera_tool[:3, :3], plan.waypoints[1].T_camera_tool[:3, 3]
    point = 1e-3 * (start + 0.3 * (end - start))
    approach = point - (point @ tangent) * tangent
    approach /= np.linalg.norm(approach)
    np.testing.assert_allclose(np.abs(R[:, 0] @ tangent), 1)
    np.testing.assert_allclose(R[:, 2], approach, atol=1e-9)
    np.testing.assert_allclose(origin, point - 0.0082 * approach, atol=1e-9)


def test_where_the_goal_is_uncertain_the_thread_is_captured_where_it_is_known_and_slid_along(bench):
    goal, thread = bench.goal(s=0.7), bench.straight(confidence=UNSURE_NEAR_THE_END)
    plan = plan_grasp(goal, thread, bench.arm(), CONFIG)
    assert plan.s_capture == pytest.approx(60 / 99)
    assert plan.probability == pytest.approx(0.6 * 0.99**9), "with the least confidence on the way"
    assert plan.slide_m == pytest.approx(0.04 * (0.7 - 60 / 99))
    assert (plan.s_goal, plan.policy) == (0.7, Policy.CAPTURE_SLIDE_GRASP)
    slide = phases(plan, Phase.SLIDE)
    np.testing.assert_allclose(np.array([w.s for w in slide]), [*(np.arange(61, 69) / 99), 0.7])
    assert {round(np.degrees(w.jaw_rad)) for w in slide} == {20}
    x = [w.T_camera_tool[0, 3] + 0.0082 * w.T_camera_tool[0, 2] for w in slide]
    np.testing.assert_allclose(x, -0.02 + 0.04 * np.array([w.s for w in slide]), atol=1e-9)


def test_where_a_slide_leaves_too_little_probability_a_less_likely_capture_with_enough_is_taken(bench):
    """From s = 60 / 99 the paper's formula gives 0.99^15 = 0.86, but the thread is known by 0.58 on the way."""
    thread = bench.straight(confidence=[1.0] * 61 + [0.58] * 39)
    plan = plan_grasp(bench.goal(s=75 / 99), thread, bench.arm(), CONFIG)
    assert plan.status is Status.OK
    assert plan.s_capture == pytest.approx(75 / 99)
    assert plan.probability == pytest.approx(0.58)


@pytest.mark.parametrize("policy", Policy)
@pytest.mark.parametrize(
    "thread", [{"confidence": [1.0] * 70 + [0.1] * 30}, {"unseen": [(0.8, 1.0)]}], ids=["hardly known", "unseen"]
)
def test_no_grasp_ends_where_the_thread_is_unseen_or_hardly_known(bench, policy, thread):
    plan = plan_grasp(bench.goal(s=0.9, policy=policy), bench.straight(**thread), bench.arm(), CONFIG)
    assert plan.status is Status.FAILED
    assert "unseen" in plan.reason
    assert (plan.probability, plan.s_goal, plan.waypoints) == (0, 0.9, ())


@pytest.mark.parametrize(
    "between", [{"confidence": [1.0] * 45 + [0.4] * 10 + [1.0] * 45}, {"unseen": [(0.45, 0.55)]}], ids=["known", "seen"]
)
def test_no_slide_leads_through_what_is_unseen_or_hardly_known(bench, between):
    """Only before it is there room for the approach, 15 mm nearer to the camera."""
    arm = bench.arm((0, 0, -0.01), reachable=lambda T: (T[:, 0, 3] < -0.003) | (T[:, 2, 3] > 0.045))
    assert plan_grasp(bench.goal(s=0.7), bench.straight(), arm, CONFIG).s_capture is not None
    plan = plan_grasp(bench.goal(s=0.7), bench.straight(**between), arm, CONFIG)
    assert plan.status is Status.FAILED
    assert "unseen, undecided or hardly known up to the goal" in plan.reason


@pytest.mark.parametrize("join", [(0.51, 0.51), (0.5095, 0.5105)], ids=["of one place", "between two samples"])
def test_no_slide_leads_over_an_undecided_join_however_short(bench, join):
    arm = bench.arm((0, 0, -0.01), reachable=lambda T: (T[:, 0, 3] < -0.003) | (T[:, 2, 3] > 0.045))
    for between, status in ((0.99, Status.OK), (0.6, Status.FAILED)):
        joins, probability = np.array([[0.0, 0.0], join, [1.0, 1.0]]), np.array([1.0, between, 1.0])
        course = ThreadCourse(joins, probability, np.array([[0.0, join[0]], [1.0, join[1]]]))
        thread = dataclasses.replace(bench.straight(), course=course)
        assert plan_grasp(bench.goal(s=0.7), thread, arm, CONFIG).status is status


def test_no_grasp_or_slide_is_where_the_thread_may_lead_elsewhere(bench):
    joins = np.array([[0.0, 0.0], [0.45, 0.55], [1.0, 1.0]])
    other = np.array([[0.0, 0.45], [1.0, 0.55]])
    doubtful, sure = (
        dataclasses.replace(bench.straight(), course=ThreadCourse(joins, np.array([1.0, between, 0.5]), other))
        for between in (0.9, 0.99)
    )
    assert plan_grasp(bench.goal(s=0.5), sure, bench.arm(), CONFIG).status is Status.OK
    assert plan_grasp(bench.goal(s=0.5), doubtful, bench.arm(), CONFIG).status is Status.FAILED
    # an end that may lead on elsewhere does not speak against what is seen of the thread
    beyond = plan_grasp(bench.goal(s=0.8), doubtful, bench.arm(), CONFIG)
    assert beyond.status is Status.OK
    assert beyond.s_capture is not None
    assert beyond.s_capture > 0.55


def test_phases_follow_each_other_and_the_tool_never_flips_while_it_slides(bench):
    x = np.linspace(-20, 20, 14)
    wavy = bench.thread(np.column_stack((x, 9 * np.sin(x / 5), 70 + 6 * np.cos(x / 8))), confidence=UNSURE_NEAR_THE_END)
    plan = plan_grasp(bench.goal(s=0.7), wavy, bench.arm(), CONFIG)
    assert [w.phase.value for w in plan.waypoints] == sorted(w.phase.value for w in plan.waypoints)
    assert {w.phase for w in plan.waypoints} == set(Phase)
    R = np.array([w.T_camera_tool[:3, :3] for w in plan.waypoints])
    angle = np.arccos(np.clip((np.einsum("nij,nij->n", R[1:], R[:-1]) - 1) / 2, -1, 1))
    assert np.degrees(angle.max()) < 15


def test_the_jaws_take_the_side_to_which_the_tool_has_to_turn_least_of_those_that_are_reachable(bench):
    half_a_turn = np.diag([-1.0, -1, 1, 1])
    only_turned = bench.arm(reachable=lambda T: T[:, 0, 0] < 0)
    for arm, taken in (
        (bench.arm(), np.eye(4)),
        (bench.arm(tool=half_a_turn), half_a_turn),
        (only_turned, half_a_turn),
    ):
        plan = plan_grasp(bench.goal(s=0.5), bench.straight(), arm, CONFIG)
        np.testing.assert_allclose(plan.waypoints[0].T_camera_tool[:3, :3], taken[:3, :3], atol=1e-9)


def test_the_approach_comes_from_the_base_where_the_viewing_ray_runs_along_the_thread_or_is_not_reached(bench):
    thread = bench.straight((1, 0, 50), (2, 0, 90))
    plan = plan_grasp(bench.goal(s=0.5), thread, bench.arm(base_camera=(0.1, 0.0, 0.03)), CONFIG)
    assert plan.status is Status.OK
    assert plan.waypoints[0].T_camera_tool[0, 2] < -0.9, "the fingers point away from the base, towards -x"
    arm = bench.arm(base_camera=(0.0, -0.1, 0.0), reachable=lambda T: T[:, 1, 2] > 0.5)
    plan = plan_grasp(bench.goal(s=0.5), bench.straight(), arm, CONFIG)
    fingers = plan.waypoints[0].T_camera_tool[:3, 2]
    np.testing.assert_allclose(fingers, np.array([0, 0.1, 0.06]) / np.hypot(0.1, 0.06), atol=1e-9)


def test_a_capture_out_of_reach_gives_way_to_one_within_and_is_told_of(bench):
    confidence = [1.0] * 40 + [0.6] * 30 + [0.9] * 30
    arm = bench.arm(reachable=lambda T: T[:, 0, 3] > -0.003)
    plan = plan_grasp(bench.goal(s=0.55), bench.straight(confidence=confidence), arm, CONFIG)
    assert plan.s_capture == pytest.approx(70 / 99)
    assert "unreachable" in {a.reason for a in plan.alternatives}
    assert "another capture is better" in {a.reason for a in plan.alternatives}


def test_nothing_is_captured_on_a_hidden_stretch(bench):
    thread = bench.straight(unseen=[(0.4, 0.6)])
    plan = plan_grasp(bench.goal(s=0.39), thread, bench.arm(), CONFIG)
    assert plan.s_capture == 0.39
    assert {a.reason for a in plan.alternatives} == {"unseen", "another capture is better"}
    direct = plan_grasp(bench.goal(s=0.5, policy=Policy.DIRECT), thread, bench.arm(), CONFIG)
    assert direct.reason == "the thread cannot be grasped directly at s = 0.500: unseen"


def test_nothing_is_captured_at_a_crossing_or_slid_across_it(bench):
    """The strands meet at s = 20/105 and 90/105; open jaws reach 8.2 mm · tan 30° = 4.73 mm to each side."""
    loop = bench.polyline((-20, 0, 60), (20, 0, 60), (20, 15, 60), (0, 15, 60), (0, -15, 60))

    def planned(s, policy=Policy.CAPTURE_SLIDE_GRASP, thread=loop):
        return plan_grasp(bench.goal(s=s, policy=policy), thread, bench.arm(), CONFIG)

    plan = planned(16 / 105)
    assert plan.status is Status.OK
    assert plan.s_capture is not None
    assert abs(20 - 105 * plan.s_capture) > 4.7
    assert "another strand" in planned(20 / 105).reason, "a goal on the crossing"
    direct = planned(16 / 105, Policy.DIRECT)
    assert direct.reason == "the thread cannot be grasped directly at s = 0.152: another strand beside it"
    # all of the right side is known well, yet it lies beyond the crossing
    s = np.linspace(0, 1, 400)
    unsure = dataclasses.replace(loop, confidence_s=s, confidence=np.where(s < 0.3, 0.5, 1))
    blocked = planned(16 / 105, thread=unsure)
    assert blocked.status is Status.FAILED
    assert "and 0.50 is asked for" in blocked.reason
    assert "another strand on the way to the goal" in {a.reason for a in blocked.alternatives}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda b: {"thread": b.failed("it was out of focus")}, "there is no thread: it was out of focus"),
        (lambda b: {"thread": b.in_unit(b.straight(), None)}, "metres_per_unit"),
        (lambda b: {"goal": b.goal(pixel=(10, 10))}, "px off the thread"),
        (lambda b: {"goal": b.goal(point_camera=(0, 0, 0.2))}, "140.0 mm off the thread"),
        (lambda b: {"arm": b.arm(reachable=lambda T: np.zeros(len(T), bool))}, "100 unreachable"),
        (lambda b: {"thread": b.straight((-20, 40, 60), (20, 40, 60))}, "100 unseen"),
        (
            lambda b: {"thread": b.straight(confidence=[0.1, 0.2])},
            "100 unseen, undecided or hardly known up to the goal",
        ),
        (
            lambda b: {"thread": b.straight((0, 0, 50), (0.1, 0, 90)), "arm": b.arm(base_camera=(0, 0, -0.1))},
            "100 thread along the approach",
        ),
    ],
)
def test_each_rejection_says_why(bench, change, said):
    given_ = {"goal": bench.goal(s=0.9), "thread": bench.straight(), "arm": bench.arm()} | change(bench)
    plan = plan_grasp(given_["goal"], given_["thread"], given_["arm"], CONFIG)
    assert plan.status is Status.FAILED
    assert said in plan.reason
    assert (plan.waypoints, plan.s_capture, plan.slide_m) == ((), None, 0)
    assert decode(GraspPlan, encode(plan)).reason == plan.reason


def test_a_sharp_corner_is_not_slid_around(bench):
    corner = bench.polyline((-10, -10, 60), (10, -10, 60), (10, 10, 60), confidence=[0.9] * 5 + [0.6] * 5)
    plan = plan_grasp(bench.goal(s=0.6), corner, bench.arm(), CONFIG)
    assert "turns too sharply" in {a.reason for a in plan.alternatives}
    assert plan.s_capture is not None
    assert plan.s_capture > 0.5


def test_the_unit_of_the_calibration_makes_no_difference(bench):
    goal, thread = bench.goal(s=0.7), bench.straight(confidence=UNSURE_NEAR_THE_END)
    one, other = (plan_grasp(goal, each, bench.arm(), CONFIG) for each in (thread, bench.in_unit(thread, 1.0)))
    assert other.slide_m == pytest.approx(one.slide_m)
    for a, b in zip(one.waypoints, other.waypoints, strict=True):
        np.testing.assert_allclose(a.T_camera_tool, b.T_camera_tool, atol=1e-9)


def test_a_deeper_grasp_reaches_further_past_the_thread(bench):
    for depth_m in (0.0, 0.0051):
        config = PlannerConfig(depth_m=depth_m)
        plan = plan_grasp(bench.goal(s=0.5), bench.straight(), bench.arm(), config)
        T = plan.waypoints[1].T_camera_tool
        assert T[2, 3] + 0.0102 * T[2, 2] == pytest.approx(0.06 + depth_m)


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
def test_any_thread_and_goal_end_in_a_plan_or_a_reason_that_can_be_sent(bench, thread, goal, policy, base, reach):
    arm = bench.arm((base, -base, -0.05), reachable=lambda T: np.linalg.norm(T[:, :3, 3], axis=1) < reach)
    config = PlannerConfig(least_probability=0.05, goal_within_px=200)
    request, reconstruction = bench.goal(**goal, policy=policy), bench.thread(**thread)
    plan = plan_grasp(request, reconstruction, arm, config)
    assert encode(plan_grasp(request, reconstruction, arm, config)) == encode(plan), "the same again"
    assert encode(decode(GraspPlan, encode(plan))) == encode(plan)
    assert (plan.plan_id, plan.goal_id, plan.stamp) == ("plan-g1", "g1", reconstruction.stamp)
    for waypoint in plan.waypoints:
        assert np.linalg.norm(waypoint.T_camera_tool[:3, 3]) < reach


@settings(max_examples=20)
@given(st.lists(st.tuples(*[ANY_NUMBER] * 3), min_size=4, max_size=6), st.floats(1e-300, 1e300), GOALS)
def test_absurd_numbers_end_in_a_reason(bench, control_points, metres_per_unit, goal):
    camera = dataclasses.replace(bench.CAMERA, metres_per_unit=metres_per_unit)
    plan = plan_grasp(bench.goal(**goal), bench.thread(control_points, camera=camera), bench.arm(), CONFIG)
    assert decode(GraspPlan, encode(plan)).status is plan.status
