"""The planner as an agent: what it remembers, what it refuses, and that it answers the same again."""

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.agent import Planner, reaches_of
from agents.planner.config import PlannerConfig
from agents.planner.tools import tool_cells
from schemas.checks import MessageError
from schemas.messages import (
    CommandAnswer,
    FrameStamp,
    HostClock,
    HostClocks,
    Outcome,
    Phase,
    Policy,
    RobotMode,
    RobotState,
    Status,
    ThreadTrack,
    TrackStep,
)
from schemas.topics import CLOCKS, GOAL, PLAN, ROBOT_STATE, SURFACE, THREAD, key
from shared.kinematics import psm
from shared.kinematics.dh_file import read_dh
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import compose, inverse, transform
from shared.runtime.agent import Command, Received
from tests.agents.planner import bench

MS = 1_000_000
OLDEST_MS = round(THREAD.maximum_age_ms or 0)
JOINTS = np.array([0.0, 0, 0.1, 0, 0, 0])
BASE = SIMULATED_BASES["psm1"]
NOWHERE = np.zeros((22, 40), bool)
HALF_A_TURN = np.diag([-1.0, -1, 1, 1])


def state(arm="psm1", late_ms=0, **changes):
    at_ns = bench.CAPTURED_NS + late_ms * MS
    made = RobotState(arm, at_ns, RobotMode.IDLE, psm.forward(JOINTS), JOINTS, 0.0, BASE, "")
    return dataclasses.replace(made, **changes)


def far_thread(**rest):
    return bench.straight((-20, 5, 80), (20, -5, 85), **rest)


def feed(planner, topic, message, instance="main"):
    assert list(planner.step(Received(topic, key("lab", topic, instance), 0, message))) == []


def ask(planner, after_ms=50, **goal: Any) -> list[Any]:
    """The answer to a goal, by default one in the middle of the thread, and the plan that follows it."""
    named: dict[str, Any] = {"s": 0.4} | goal
    asked = bench.goal(**named)
    return list(planner.step(Command(GOAL, "main", asked, bench.CAPTURED_NS + after_ms * MS)))


def planned(planner, after_ms=50, **goal) -> Any:
    return ask(planner, after_ms, **goal)[1].message


def refused(planner, after_ms=50, **goal):
    """The code and the reason of a goal that is refused."""
    (answer,) = ask(planner, after_ms, **goal)
    assert (answer.id, answer.outcome) == ("g1", Outcome.REFUSED)
    return answer.code, answer.reason


def ready(config=None, thread=None, told=None, **rest):
    """A planner that has a thread and one arm."""
    made = Planner(config, **rest)
    feed(made, THREAD, thread or far_thread())
    feed(made, ROBOT_STATE, told or state(), "psm1")
    return made


@pytest.fixture
def planner():
    return ready()


def test_a_goal_is_accepted_and_followed_by_its_plan(planner):
    answer, output = ask(planner)
    assert answer == CommandAnswer("g1", Outcome.ACCEPTED, "", "")
    assert output.topic is PLAN
    plan = output.message
    assert (plan.plan_id, plan.arm, plan.status, plan.s_goal) == ("plan-g1", "psm1", Status.OK, 0.4)
    assert {w.phase for w in plan.waypoints} == set(Phase) - {Phase.SLIDE, Phase.PULL, Phase.RELEASE}


@pytest.mark.parametrize(
    ("changes", "after_ms", "said"),
    [
        (None, 50, "perception has told of none yet"),
        ({}, 3100, "it was seen 3100 ms ago, and at most 3000 ms are accepted"),
        ({"stamp": FrameStamp(6, bench.CAPTURED_NS, bench.CAPTURED_NS, "other")}, 50, "another calibration"),
        ({"deviation": None}, 50, "how sure"),
        ({"valid": NOWHERE, "depth": 0.0 * NOWHERE, "deviation": 0.0 * NOWHERE}, 50, "no texture"),
    ],
)
def test_against_a_surface_of_no_use_nothing_is_checked_and_the_plan_says_why(changes, after_ms, said):
    seen_ns = bench.CAPTURED_NS + after_ms * MS
    thread = dataclasses.replace(far_thread(), stamp=FrameStamp(7, seen_ns, seen_ns, "bench"))
    planner = ready(thread=thread, told=state(late_ms=after_ms))
    if changes is not None:
        # nothing fits before tissue so near
        feed(planner, SURFACE, dataclasses.replace(bench.surface(60.0), **changes))
    plan = planned(planner, after_ms)
    assert (plan.status, plan.tissue.clearance_m) == (Status.OK, None)
    assert plan.tissue.unchecked.startswith("not checked against tissue: ")
    assert said in plan.tissue.unchecked
    planner.configure(dataclasses.replace(planner.config, tissue_required=True))
    plan = planned(planner, after_ms)
    assert plan.status is Status.FAILED
    assert said in plan.reason


def test_what_is_measured_where_a_tool_is_counts_as_no_tissue():
    """The tool stands in the view 2 cm before the thread, where the jaws are to go."""
    there = state()
    T_camera_tool = transform(compose(there.T_camera_base, there.T_base_tool)[:3, :3], np.array([0.0, 0.0, 0.062]))
    there = dataclasses.replace(there, T_base_tool=compose(inverse(there.T_camera_base), T_camera_tool))
    surface = bench.surface(lambda u, v: np.where(np.hypot(u - 479.5, v - 269.5) < 60, 62.0, 86.0))
    planner = ready(told=there, reaches=lambda T: np.ones(len(T), bool))
    feed(planner, SURFACE, surface)
    np.testing.assert_array_equal(tool_cells(surface, [there], 0.01), surface.depth == 62.0)
    assert planned(planner, s=0.5, policy=Policy.DIRECT).status is Status.OK
    planner.configure(dataclasses.replace(planner.config, tool_near_m=0.0))
    assert "tissue" in planned(planner, s=0.5, policy=Policy.DIRECT).reason


@pytest.mark.slow
def test_an_arm_that_is_no_psm_is_asked_by_its_own_geometry_and_without_it_the_answer_says_so():
    """An arm from its table, its tool 15 mm before the middle of the thread."""
    told = tomllib.loads((Path(__file__).parents[3] / "deploy" / "generic_arm.toml").read_text())
    arm, config = read_dh(told), PlannerConfig(least_probability=0.0)
    T_base_tool = arm.forward(np.array(told["start"]))
    T_camera_base = compose(transform(np.eye(3), np.array([0.0, 0.0, 0.06])), inverse(T_base_tool))
    there = state(kinematics=arm.name, T_base_tool=T_base_tool, T_camera_base=T_camera_base)
    planner = ready(config, told=there, others={"psm1": arm})
    answer, output = ask(planner)
    assert (answer.outcome, answer.reason, output.message.status) == (Outcome.ACCEPTED, "", Status.OK)
    poses = np.array([w.T_camera_tool for w in output.message.waypoints])
    assert not arm.reach(compose(inverse(there.T_camera_base), poses)).problem.any()
    away = dataclasses.replace(there, T_camera_base=transform(np.eye(3), np.array([2.0, 0.0, 0.0])))
    feed(planner, ROBOT_STATE, away, "psm1")
    assert "unreachable" in planned(planner).reason
    answer, output = ask(ready(config, told=away))
    assert "whether the arm reaches the plan is not known" in answer.reason
    assert output.message.status is Status.OK, output.message.reason


def test_the_jaws_take_the_side_that_the_tool_is_on_now():
    # a base that is turned half around, so that the tool's attitude in its frame is that of the other side
    turned = state(T_camera_base=HALF_A_TURN)
    planner = ready(told=turned, reaches=lambda T: np.ones(len(T), bool))
    for side in (np.eye(4), HALF_A_TURN):
        T_camera_tool = planned(planner).waypoints[0].T_camera_tool @ side
        now = dataclasses.replace(turned, T_base_tool=turned.T_camera_base @ T_camera_tool)
        feed(planner, ROBOT_STATE, now, "psm1")
        again = planned(planner).waypoints[0].T_camera_tool
        np.testing.assert_allclose(again, T_camera_tool, atol=1e-9)


def test_an_arm_reaches_where_its_joints_can_be_and_are_not_near_a_singular_pose():
    bent = np.array([[0.3, -0.2, 0.15, 1.0, wrist, -0.3] for wrist in (0.4, 1.3, 1.39)])
    dexterity = psm.LARGE_NEEDLE_DRIVER.dexterity(bent)
    assert dexterity[0] > 0.9 > dexterity[1] > dexterity[2]
    outside = np.eye(4)
    outside[2, 3] = -0.5
    reaches = reaches_of(psm.LARGE_NEEDLE_DRIVER, dexterity[1:].mean())
    np.testing.assert_array_equal(reaches(np.array([*psm.forward(bent), outside])), [True, True, False, False])
    for least, status in ((0.3, Status.OK), (0.999, Status.FAILED)):
        plan = planned(ready(PlannerConfig(least_dexterity=least)))
        assert (plan.status, "unreachable" in plan.reason) == (status, status is Status.FAILED)


def test_each_arm_gets_a_plan_within_its_own_joints_from_its_own_base():
    planner = ready()
    for name, base in SIMULATED_BASES.items():
        feed(planner, ROBOT_STATE, state(name, T_camera_base=base), name)
    reaches = reaches_of(psm.LARGE_NEEDLE_DRIVER, planner.config.least_dexterity)
    for name, base in SIMULATED_BASES.items():
        plan = planned(planner, arm=name)
        assert (plan.arm, plan.status) == (name, Status.OK)
        assert reaches(compose(inverse(base), np.array([w.T_camera_tool for w in plan.waypoints]))).all()
    away = state("psm2", T_camera_base=transform(np.eye(3), np.array([0.5, 0.0, 0.0])))
    feed(planner, ROBOT_STATE, away, "psm2")
    assert planned(planner).status is Status.OK
    assert "unreachable" in planned(planner, arm="psm2").reason


def test_a_goal_without_a_fresh_thread_in_a_known_unit_or_an_arm_that_reports_is_refused_with_a_code(planner):
    for goal, after_ms, code, said in (
        ({"arm": "psm2"}, 50, "unknown_arm", "no arm called psm2 has reported; there are: psm1"),
        ({"arm": "psm2"}, OLDEST_MS + 1, "unknown_arm", "no arm called psm2"),
        ({}, OLDEST_MS + 1, "thread_stale", f"seen {OLDEST_MS + 1} ms ago, and at most {OLDEST_MS} ms"),
        ({}, -OLDEST_MS - 1, "thread_from_future", f"{OLDEST_MS + 1} ms from now; set the clocks"),
    ):
        found, reason = refused(planner, after_ms, **goal)
        assert (found, said in reason) == (code, True), reason
    for older in ("capture_left_ns", "capture_right_ns"):
        stamp = dataclasses.replace(far_thread().stamp, **{older: bench.CAPTURED_NS - OLDEST_MS * MS})
        feed(planner, THREAD, dataclasses.replace(far_thread(), stamp=stamp))
        assert refused(planner)[0] == "thread_stale"
    feed(planner, THREAD, bench.in_unit(far_thread(), None))
    assert refused(planner)[0] == "unit_unknown"
    begun = Planner()
    assert refused(begun)[0] == "no_thread"
    feed(begun, THREAD, far_thread())
    assert refused(begun) == ("unknown_arm", "no arm called psm1 has reported; there is none; is its bridge running?")
    feed(begun, ROBOT_STATE, state(late_ms=-round(begun.config.arm_age_ms + 100)), "psm1")
    assert refused(begun)[0] == "arm_stale"
    feed(begun, ROBOT_STATE, dataclasses.replace(state(), mode=RobotMode.MOVING, plan_id="p1"), "psm1")
    assert refused(begun) == ("arm_moves", "psm1 carries out plan p1: let it end, or say hold, first")


def followed(thread, step):
    """The thread as it is followed from frame to frame, whatever else is told of that."""
    reason = "" if step in (TrackStep.STARTED, TrackStep.CONTINUED) else "it was hidden"
    knots, covariance, ends = np.repeat([0.0, 1.0], 4), np.zeros((4, 4, 3, 3)), np.array([0.0, 1.0])
    told = 1, 0.1, 1.0, thread.stamp, knots, np.zeros((4, 3)), covariance, 1.0, np.ones(1), 0.0, 1.0, ends
    return dataclasses.replace(thread, track=ThreadTrack(step, reason, *told))


def test_a_goal_by_s_is_refused_in_the_frame_in_which_the_thread_was_found_anew(planner):
    for step in TrackStep:
        feed(planner, THREAD, followed(far_thread(), step))
        by_point = ask(planner, s=None, point_camera=(-0.004, 0.001, 0.082))[0]
        assert by_point.outcome is Outcome.ACCEPTED
        by_s = ask(planner)[0]
        assert by_s.code == ("thread_restarted" if step is TrackStep.RESTARTED else "")


WRONG: dict[str, Any] = {
    "samples": 1,
    "keep_probability": 0.0,
    "least_probability": 1.5,
    "depth_m": 0.02,
    "slide_deg": 70.0,
}


@pytest.mark.parametrize("name", WRONG)
def test_a_configuration_that_makes_no_sense_is_refused_by_name(name):
    with pytest.raises(MessageError, match=name):
        PlannerConfig(**{name: WRONG[name]})


def clocks_of(ahead_ms: float | None, within_ms: float | None = 1.0, agent="camera"):
    return HostClocks(0, (HostClock(agent, "main", "video-pc", ahead_ms, within_ms),))


def test_frames_of_a_host_whose_clock_is_out_of_bounds_are_refused_whatever_their_age(planner):
    for ahead_ms, where in ((340.0, "340 ms ahead of"), (-9000.0, "9000 ms behind")):
        feed(planner, CLOCKS, clocks_of(ahead_ms))
        for after_ms in (50, -20_000):
            code, reason = refused(planner, after_ms)
            assert code == "clock_out_of_bounds"
            assert all(said in reason for said in ("video-pc", where, "within 1.0 ms", "at most 100 ms")), reason
    feed(planner, CLOCKS, clocks_of(None, None))
    assert "gives no answer" in ask(planner)[0].reason
    # of others than the camera nothing depends
    feed(planner, CLOCKS, clocks_of(5000.0, agent="robot_bridge"))
    assert ask(planner)[0] == CommandAnswer("g1", Outcome.ACCEPTED, "", "")


@settings(max_examples=20)
@given(ahead_ms=st.floats(-1e5, 1e5), within_ms=st.floats(0, 1e5))
def test_a_clock_is_refused_for_certain_only_and_what_cannot_be_told_is_said(ahead_ms, within_ms):
    planner = ready()
    feed(planner, CLOCKS, clocks_of(ahead_ms, within_ms))
    answer = ask(planner)[0]
    assert (answer.outcome is Outcome.REFUSED) == (abs(ahead_ms) - within_ms > 100)
    certainly_well = abs(ahead_ms) + within_ms <= 100
    assert (answer.reason == "") == certainly_well
    assert ("cannot be told" in answer.reason) == (answer.outcome is Outcome.ACCEPTED and not certainly_well)
