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
from shared.runtime.agent import Command, Output, Received

MS = 1_000_000
OLDEST_MS = round(THREAD.maximum_age_ms or 0)
REMOTE_CENTRE = np.array([0.09, -0.06, -0.04])
JOINTS = np.array([0.0, 0, 0.1, 0, 0, 0])


def base_that_looks_at(target):
    """A PSM of which the shaft, along -z of the base at joints of zero, points from its trocar at the target."""
    z = (REMOTE_CENTRE - target) / np.linalg.norm(REMOTE_CENTRE - target)
    x = np.cross([0.0, 1, 0], z) / np.linalg.norm(np.cross([0.0, 1, 0], z))
    return transform(np.column_stack((x, np.cross(z, x), z)), REMOTE_CENTRE)


def state(bench, arm="psm1", late_ms=0):
    return RobotState(
        arm=arm,
        measured_ns=bench.CAPTURED_NS + late_ms * MS,
        mode=RobotMode.IDLE,
        T_base_tool=psm.forward(JOINTS),
        joints=JOINTS,
        jaw_rad=0.0,
        T_camera_base=base_that_looks_at(np.array([0, 0, 0.08])),
        plan_id="",
    )


def far_thread(bench, **rest):
    return bench.straight((-20, 5, 80), (20, -5, 85), **rest)


def feed(planner, topic, message, instance="main"):
    return list(planner.step(Received(topic, key("lab", topic, instance), 0, message)))


def ask(planner, bench, goal, after_ms=50) -> list[Any]:
    return list(planner.step(Command(GOAL, "main", goal, bench.CAPTURED_NS + after_ms * MS)))


def planned(planner, bench, after_ms=50, **goal) -> Any:
    """The plan for a goal, by default one in the middle of the thread."""
    return ask(planner, bench, bench.goal(**({"s": 0.4} | goal)), after_ms)[1].message


def ready(bench, config=None, thread=None, told=None, **rest):
    """A planner that has a thread and one arm."""
    made = Planner(config, **rest)
    assert feed(made, THREAD, thread or far_thread(bench)) == []
    assert feed(made, ROBOT_STATE, told or state(bench), "psm1") == []
    return made


@pytest.fixture
def planner(bench):
    return ready(bench)


def test_a_goal_is_accepted_and_followed_by_its_plan(bench, planner):
    answer, output = ask(planner, bench, bench.goal(s=0.4))
    assert answer == CommandAnswer("g1", Outcome.ACCEPTED, "", "")
    assert isinstance(output, Output)
    assert output.topic is PLAN
    plan = output.message
    assert (plan.plan_id, plan.arm, plan.status, plan.s_goal) == ("plan-g1", "psm1", Status.OK, 0.4)
    assert {w.phase for w in plan.waypoints} == set(Phase) - {Phase.SLIDE}


def feed_surface(planner, bench, depth_mm=85.0, **changes):
    surface = dataclasses.replace(bench.surface(depth_mm), **changes)
    feed(planner, SURFACE, surface)
    return surface


@pytest.mark.slow
def test_a_plan_is_checked_against_the_newest_surface_and_names_its_frame(bench, planner):
    feed_surface(planner, bench, 75.0)
    answer, output = ask(planner, bench, bench.goal(s=0.4))
    assert answer.outcome is Outcome.ACCEPTED
    assert "jaws would press into the tissue" in output.message.reason
    surface = feed_surface(planner, bench, 83.0)
    plan = planned(planner, bench)
    assert (plan.status, plan.tissue.stamp, plan.tissue.unchecked) == (Status.OK, surface.stamp, "")
    assert -0.002 < plan.tissue.clearance_m < 0.0005


OTHER_CALIBRATION = FrameStamp(6, 1_760_000_000_000_000_000, 1_760_000_000_000_000_000, "another")


@pytest.mark.parametrize(
    ("changes", "after_ms", "said"),
    [
        (None, 50, "perception has told of none yet"),
        ({}, 3100, "it was seen 3100 ms ago, and at most 3000 ms are accepted"),
        ({"stamp": OTHER_CALIBRATION}, 50, "another calibration"),
        ({"deviation": None}, 50, "how sure"),
        (
            {key: np.zeros((22, 40), t) for key, t in (("valid", bool), ("depth", float), ("deviation", float))},
            50,
            "no",
        ),
    ],
)
def test_against_a_surface_of_no_use_nothing_is_checked_and_the_plan_says_why(bench, changes, after_ms, said):
    stamp = FrameStamp(7, bench.CAPTURED_NS + after_ms * MS, bench.CAPTURED_NS + after_ms * MS, "bench")
    thread = dataclasses.replace(far_thread(bench), stamp=stamp)
    planner = ready(bench, thread=thread, told=state(bench, late_ms=after_ms))
    if changes is not None:
        # nothing fits before tissue so near
        feed_surface(planner, bench, 60.0, **changes)
    plan = planned(planner, bench, after_ms)
    assert plan.status is Status.OK
    assert plan.tissue.unchecked.startswith("not checked against tissue: ")
    assert said in plan.tissue.unchecked
    assert plan.tissue.clearance_m is None


def test_tissue_can_be_required_while_the_planner_runs(bench, planner):
    planner.configure(dataclasses.replace(planner.config, tissue_required=True))
    plan = planned(planner, bench)
    assert plan.status is Status.FAILED
    assert "perception has told of none yet" in plan.reason


def test_what_is_measured_where_a_tool_is_counts_as_no_tissue(bench):
    """The tool stands in the view 2 cm before the thread, where the jaws are to go."""
    there = state(bench)
    T_camera_tool = transform(compose(there.T_camera_base, there.T_base_tool)[:3, :3], np.array([0.0, 0.0, 0.062]))
    there = dataclasses.replace(there, T_base_tool=compose(inverse(there.T_camera_base), T_camera_tool))
    surface = bench.surface(lambda u, v: np.where(np.hypot(u - 479.5, v - 269.5) < 60, 62.0, 86.0))
    planner = ready(bench, told=there, reaches=lambda T: np.ones(len(T), bool))
    feed(planner, SURFACE, surface)
    np.testing.assert_array_equal(tool_cells(surface, [there], 0.01), surface.depth == 62.0)
    assert planned(planner, bench, s=0.5, policy=Policy.DIRECT).status is Status.OK
    planner.configure(dataclasses.replace(planner.config, tool_near_m=0.0))
    assert "tissue" in planned(planner, bench, s=0.5, policy=Policy.DIRECT).reason


def generic_arm(bench):
    """An arm from its table, and its state with the tool 15 mm before the middle of the thread."""
    told = tomllib.loads((Path(__file__).parents[3] / "deploy" / "generic_arm.toml").read_text())
    arm = read_dh(told)
    there = transform(np.eye(3), np.array([0.0, 0.0, 0.06]))
    T_base_tool = arm.forward(np.array(told["start"]))
    changed = {
        "kinematics": arm.name,
        "T_base_tool": T_base_tool,
        "T_camera_base": compose(there, inverse(T_base_tool)),
    }
    return arm, dataclasses.replace(state(bench), **changed)


@pytest.mark.slow
def test_an_arm_that_is_no_psm_is_asked_by_its_own_geometry(bench):
    arm, there = generic_arm(bench)
    planner = ready(bench, PlannerConfig(least_probability=0.0), told=there, others={"psm1": arm})
    answer, output = ask(planner, bench, bench.goal(s=0.4))
    assert (answer.outcome, answer.reason) == (Outcome.ACCEPTED, "")
    assert output.message.status is Status.OK, output.message.reason
    poses = np.array([w.T_camera_tool for w in output.message.waypoints])
    assert not arm.reach(compose(inverse(there.T_camera_base), poses)).problem.any()
    away = dataclasses.replace(there, T_camera_base=transform(np.eye(3), np.array([2.0, 0.0, 0.0])))
    feed(planner, ROBOT_STATE, away, "psm1")
    assert "unreachable" in planned(planner, bench).reason


def test_of_an_arm_whose_geometry_nobody_told_the_answer_says_that_reach_is_not_known(bench):
    _, there = generic_arm(bench)
    told = dataclasses.replace(there, T_camera_base=np.eye(4))
    planner = ready(bench, PlannerConfig(least_probability=0.0), told=told)
    answer, output = ask(planner, bench, bench.goal(s=0.4))
    assert "whether the arm reaches the plan is not known" in answer.reason
    assert output.message.status is Status.OK, output.message.reason


def test_the_jaws_take_the_side_that_the_tool_is_on_now(bench):
    # a base that is turned half around, so that the tool's attitude in its frame is that of the other side
    turned = dataclasses.replace(state(bench), T_camera_base=np.diag([-1.0, -1, 1, 1]))
    planner = ready(bench, told=turned, reaches=lambda T: np.ones(len(T), bool))
    for side in (np.eye(4), np.diag([-1.0, -1, 1, 1])):
        T_camera_tool = planned(planner, bench).waypoints[0].T_camera_tool @ side
        now = dataclasses.replace(turned, T_base_tool=turned.T_camera_base @ T_camera_tool)
        feed(planner, ROBOT_STATE, now, "psm1")
        again = planned(planner, bench).waypoints[0].T_camera_tool
        np.testing.assert_allclose(again, T_camera_tool, atol=1e-9)


def test_an_arm_reaches_where_its_joints_can_be_and_are_not_near_a_singular_pose():
    bent = np.array([[0.3, -0.2, 0.15, 1.0, wrist, -0.3] for wrist in (0.4, 1.3, 1.39)])
    dexterity = psm.LARGE_NEEDLE_DRIVER.dexterity(bent)
    assert dexterity[0] > 0.9 > dexterity[1] > dexterity[2]
    outside = np.eye(4)
    outside[2, 3] = -0.5
    reaches = reaches_of(psm.LARGE_NEEDLE_DRIVER, dexterity[1:].mean())
    np.testing.assert_array_equal(reaches(np.array([*psm.forward(bent), outside])), [True, True, False, False])


@pytest.mark.parametrize(("least", "status"), [(0.3, Status.OK), (0.999, Status.FAILED)])
def test_a_plan_keeps_to_the_least_dexterity(bench, least, status):
    plan = planned(ready(bench, PlannerConfig(least_dexterity=least)), bench)
    assert plan.status is status, plan.reason
    assert ("unreachable" in plan.reason) == (status is Status.FAILED)


@pytest.mark.parametrize(
    ("goal", "after_ms", "code", "said"),
    [
        ({"arm": "psm2"}, 50, "unknown_arm", "no arm called psm2 has reported; there are: psm1"),
        ({"arm": "psm2"}, OLDEST_MS + 1, "unknown_arm", "no arm called psm2"),
        ({}, OLDEST_MS + 1, "thread_stale", f"seen {OLDEST_MS + 1} ms ago, and at most {OLDEST_MS} ms"),
        ({}, -OLDEST_MS - 1, "thread_from_future", f"{OLDEST_MS + 1} ms from now; set the clocks"),
    ],
)
def test_a_goal_that_cannot_be_planned_for_is_refused_with_a_code(bench, planner, goal, after_ms, code, said):
    (answer,) = ask(planner, bench, bench.goal(s=0.4, **goal), after_ms)
    assert (answer.id, answer.outcome, answer.code) == ("g1", Outcome.REFUSED, code)
    assert said in answer.reason


def test_without_a_thread_in_a_known_unit_or_an_arm_that_reports_every_goal_is_refused(bench):
    planner = Planner()

    def refused():
        (answer,) = ask(planner, bench, bench.goal(s=0.4))
        assert answer.outcome is Outcome.REFUSED
        return answer

    assert refused().code == "no_thread"
    feed(planner, THREAD, far_thread(bench))
    assert (refused().code, "there is none" in refused().reason) == ("unknown_arm", True)
    feed(planner, ROBOT_STATE, state(bench, late_ms=-round(planner.config.arm_age_ms + 100)), "psm1")
    assert refused().code == "arm_stale"
    feed(planner, ROBOT_STATE, state(bench), "psm1")
    feed(planner, THREAD, bench.in_unit(far_thread(bench), None))
    assert (refused().code, "metres_per_unit" in refused().reason) == ("unit_unknown", True)


@pytest.mark.parametrize("older", ["capture_left_ns", "capture_right_ns"])
def test_a_thread_is_as_old_as_the_older_of_its_images(bench, planner, older):
    thread = far_thread(bench)
    stamp = dataclasses.replace(thread.stamp, **{older: bench.CAPTURED_NS - OLDEST_MS * MS})
    feed(planner, THREAD, dataclasses.replace(thread, stamp=stamp))
    (answer,) = ask(planner, bench, bench.goal(s=0.4))
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "thread_stale")


def followed(thread, step):
    """The thread as it is followed from frame to frame."""
    ends = np.concatenate((np.zeros(4), np.ones(4)))
    track = ThreadTrack(
        step=step,
        reason="" if step in (TrackStep.STARTED, TrackStep.CONTINUED) else "it was hidden",
        frames=1,
        innovation=0.1,
        found_share=1.0,
        stamp=thread.stamp,
        knots=ends,
        control_points_camera=np.zeros((4, 3)),
        covariance=np.zeros((4, 4, 3, 3)),
        smoothing=1.0,
        span_weight=np.ones(1),
        row_offset_px=0.0,
        length=1.0,
        material_s=np.array([0.0, 1.0]),
    )
    return dataclasses.replace(thread, track=track)


@pytest.mark.parametrize("step", TrackStep)
def test_a_goal_by_s_is_refused_in_the_frame_in_which_the_thread_was_found_anew(bench, planner, step):
    feed(planner, THREAD, followed(far_thread(bench), step))
    by_s = ask(planner, bench, bench.goal(s=0.4))[0]
    by_point = ask(planner, bench, bench.goal(point_camera=(-0.004, 0.001, 0.082)))[0]
    assert by_point.outcome is Outcome.ACCEPTED
    if step is TrackStep.RESTARTED:
        assert (by_s.outcome, by_s.code) == (Outcome.REFUSED, "thread_restarted")
        feed(planner, THREAD, followed(far_thread(bench), TrackStep.CONTINUED))
        by_s = ask(planner, bench, bench.goal(s=0.4))[0]
    assert by_s.outcome is Outcome.ACCEPTED


def test_the_newest_thread_and_the_newest_state_of_each_arm_count(bench, planner):
    feed(planner, ROBOT_STATE, state(bench, arm="psm2"), "psm2")
    feed(planner, THREAD, far_thread(bench, confidence=[0.7, 0.7]))
    for arm in ("psm1", "psm2"):
        plan = planned(planner, bench, arm=arm)
        assert (plan.arm, plan.probability) == (arm, pytest.approx(0.7))
    feed(planner, THREAD, bench.failed("it went out of focus"))
    answer, output = ask(planner, bench, bench.goal(s=0.4))
    assert answer.outcome is Outcome.ACCEPTED
    assert output.message.reason == "there is no thread: it went out of focus"


def test_what_counts_is_the_reach_of_the_arm_that_the_goal_names_from_its_own_base(bench, planner):
    away = dataclasses.replace(state(bench, arm="psm2"), T_camera_base=transform(np.eye(3), np.array([0.5, 0.0, 0.0])))
    feed(planner, ROBOT_STATE, away, "psm2")
    assert planned(planner, bench).status is Status.OK
    assert "unreachable" in planned(planner, bench, arm="psm2").reason


@pytest.mark.parametrize("arm", SIMULATED_BASES)
def test_each_simulated_arm_gets_a_plan_within_its_own_joints(bench, arm):
    planner = Planner()
    feed(planner, THREAD, far_thread(bench))
    for name, T_camera_base in SIMULATED_BASES.items():
        feed(planner, ROBOT_STATE, dataclasses.replace(state(bench, arm=name), T_camera_base=T_camera_base), name)
    plan = planned(planner, bench, arm=arm)
    assert (plan.arm, plan.status) == (arm, Status.OK)
    T_camera_tool = np.array([w.T_camera_tool for w in plan.waypoints])
    reaches = reaches_of(psm.LARGE_NEEDLE_DRIVER, planner.config.least_dexterity)
    assert reaches(compose(inverse(SIMULATED_BASES[arm]), T_camera_tool)).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 1},
        {"keep_probability": 0.0},
        {"least_probability": 1.5},
        {"depth_m": 0.02},
        {"standoff_m": 0.0},
        {"slide_deg": 70.0},
        {"clear_deg": 5.0},
    ],
)
def test_a_configuration_that_makes_no_sense_is_refused_by_name(wrong):
    with pytest.raises(MessageError, match=next(iter(wrong))):
        PlannerConfig(**wrong)


def clocks_of(ahead_ms: float | None, within_ms: float | None = 1.0, agent="camera"):
    return HostClocks(0, (HostClock(agent, "main", "video-pc", ahead_ms, within_ms),))


@pytest.mark.parametrize(("ahead_ms", "where"), [(340.0, "340 ms ahead of"), (-9000.0, "9000 ms behind")])
def test_frames_of_a_host_whose_clock_is_out_of_bounds_are_refused_whatever_their_age(bench, planner, ahead_ms, where):
    feed(planner, CLOCKS, clocks_of(ahead_ms))
    for after_ms in (50, -20_000):
        (answer,) = ask(planner, bench, bench.goal(s=0.4), after_ms)
        assert (answer.outcome, answer.code) == (Outcome.REFUSED, "clock_out_of_bounds")
        for said in ("video-pc", where, "within 1.0 ms", "at most 100 ms", "chrony or PTP"):
            assert said in answer.reason
    feed(planner, CLOCKS, clocks_of(0.2))
    assert ask(planner, bench, bench.goal(s=0.4))[0].outcome is Outcome.ACCEPTED


@settings(max_examples=20)
@given(ahead_ms=st.floats(-1e5, 1e5), within_ms=st.floats(0, 1e5))
def test_a_clock_is_refused_for_certain_only_and_what_cannot_be_told_is_said(bench, ahead_ms, within_ms):
    planner = ready(bench)
    feed(planner, CLOCKS, clocks_of(ahead_ms, within_ms))
    answer = ask(planner, bench, bench.goal(s=0.4))[0]
    assert (answer.outcome is Outcome.REFUSED) == (abs(ahead_ms) - within_ms > 100)
    certainly_well = abs(ahead_ms) + within_ms <= 100
    assert (answer.reason == "") == certainly_well
    assert ("cannot be told" in answer.reason) == (answer.outcome is Outcome.ACCEPTED and not certainly_well)


def test_the_clocks_of_others_than_the_camera_are_not_held_against_a_goal_and_an_unknown_one_is_said(bench, planner):
    feed(planner, CLOCKS, clocks_of(5000.0, agent="robot_bridge"))
    assert ask(planner, bench, bench.goal(s=0.4))[0] == CommandAnswer("g1", Outcome.ACCEPTED, "", "")
    feed(planner, CLOCKS, clocks_of(None, None))
    answer = ask(planner, bench, bench.goal(s=0.4))[0]
    assert (answer.outcome, "gives no answer" in answer.reason) == (Outcome.ACCEPTED, True)
