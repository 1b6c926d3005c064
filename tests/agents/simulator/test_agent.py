"""Whole grasps by measured poses: one that holds, ones that miss or are lost, and what is judged of them."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.simulator.agent import Simulator, SimulatorConfig
from agents.simulator.world import hand_eye_error, tool_error
from schemas import messages
from schemas.codec import encode
from schemas.topics import EXECUTION, JUDGEMENT, PLAN, ROBOT_STATE, SIMULATOR_STATE, Topic, key
from shared.arc_length import length, parameters_at
from shared.rigid_transforms import apply, compose, inverse, rotation_from_quaternion, transform
from shared.runtime.agent import Output, Received, Tick
from shared.splines import evaluate
from tests.agents.session_report.conftest import plan as example

MM = 1e-3
GRIP_M = 8.2 * MM
OPEN, PARTLY = 1.0, 0.3
T_CAMERA_BASE = transform(rotation_from_quaternion(np.array([0.3, 0.8, -0.4, 0.2])), np.array([0.1, -0.05, 0.2]))
EXACT = SimulatorConfig(seed=3, config="medium", background="plain", tool_error_mm=0.0)


def field_at_start(config: SimulatorConfig) -> messages.SimulatorState:
    (output,) = Simulator(config).step(Tick(1))
    assert isinstance(output, Output)
    return output.message


FIELD = field_at_start(EXACT)
LENGTH_M = length(FIELD.knots, FIELD.control_points_camera, 3)


def tool_at(s: float, shift_tool_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """The pose that puts the thread at s 8.2 mm along the fingers, x along the thread, z away from the camera."""
    knots, points = FIELD.knots, FIELD.control_points_camera
    at = parameters_at(knots, points, 3, np.array([s * LENGTH_M]))
    x = evaluate(knots, points, 3, at, 1)[0]
    x /= np.linalg.norm(x)
    z = np.array([0.0, 0.0, 1.0]) - x[2] * x
    z /= np.linalg.norm(z)
    R = np.column_stack((x, np.cross(z, x), z))
    goal = evaluate(knots, points, 3, at)[0]
    return transform(R, goal - GRIP_M * z + R @ (MM * np.array(shift_tool_mm)))


def raised(T: np.ndarray, by_mm: float) -> np.ndarray:
    return T @ transform(np.eye(3), np.array([0.0, 0.0, -MM * by_mm]))


Pose = tuple[np.ndarray, float]


def closing(T: np.ndarray, start: float, end: float) -> list[Pose]:
    return [(T, float(jaw)) for jaw in np.linspace(start, end, 20)]


def capture_slide_grasp(
    s_capture: float, s_goal: float, at: Callable[[float], np.ndarray] = tool_at, closed: float = 0.0
) -> list[Pose]:
    """Down on the thread, partly closed, along it, closed, and up again."""
    down = [(raised(at(s_capture), 15.0 - k), OPEN) for k in range(16)]
    slide = [(at(float(s)), PARTLY) for s in np.linspace(s_capture, s_goal, 40)]
    up = [(raised(at(s_goal), float(k)), closed) for k in range(26)]
    return [*down, *closing(at(s_capture), OPEN, PARTLY), *slide, *closing(at(s_goal), PARTLY, closed), *up]


def direct(T: np.ndarray) -> list[Pose]:
    down = [(raised(T, 15.0 - k), OPEN) for k in range(16)]
    return [*down, *closing(T, OPEN, 0.0), *[(raised(T, float(k)), 0.0) for k in range(26)]]


def plan(T_goal: np.ndarray) -> messages.GraspPlan:
    waypoints = (messages.Waypoint(T_goal, 0.0, messages.Phase.GRASP, 0.5),)
    return dataclasses.replace(example("g1", 1, 0.0), plan_id="p1", waypoints=waypoints)


def robot_state(pose: Pose, plan_id: str = "p1", arm: str = "psm1") -> messages.RobotState:
    T_base_tool = compose(inverse(T_CAMERA_BASE), pose[0])
    return messages.RobotState(
        arm, 0, messages.RobotMode.MOVING, T_base_tool, np.zeros(6), pose[1], T_CAMERA_BASE, plan_id
    )


def ended(
    plan_id: str = "p1", kind: messages.ExecutionKind = messages.ExecutionKind.FINISHED, code: str = ""
) -> messages.ExecutionEvent:
    return messages.ExecutionEvent(plan_id, "psm1", 0, kind, None, code, "")


class Run:
    """An agent that is fed one message after another, with a tick after every robot state."""

    def __init__(self, config: SimulatorConfig = EXACT) -> None:
        self.agent = Simulator(config)
        self.outputs: list[Output] = []
        self.sequence = 0
        self.tick()

    def tick(self) -> None:
        self.sequence += 1
        self._take(self.agent.step(Tick(10_000_000 * self.sequence)))

    def rest(self) -> None:
        """So long that a plan that has ended is judged."""
        for _ in range(30):
            self.tick()

    def feed(self, topic: Topic, message: object) -> None:
        self._take(self.agent.step(Received(topic, key("r", topic, "psm1"), self.sequence, message)))

    def carry_out(self, poses: list[Pose], plan_id: str = "p1", arm: str = "psm1") -> "Run":
        for pose in poses:
            self.feed(ROBOT_STATE, robot_state(pose, plan_id, arm))
            self.tick()
        return self

    def _take(self, outputs) -> None:
        self.outputs += [output for output in outputs if isinstance(output, Output)]

    @property
    def judgements(self) -> list[messages.GraspJudgement]:
        return [output.message for output in self.outputs if output.topic is JUDGEMENT]

    @property
    def states(self) -> list[messages.SimulatorState]:
        return [output.message for output in self.outputs if output.topic is SIMULATOR_STATE]


@pytest.fixture
def run() -> Run:
    return Run()


def lifted_mm(state: messages.SimulatorState) -> float:
    """How far the thread stands off the tissue at most."""
    return 95.0 - state.control_points_camera[:, 2].min() / MM


def test_a_thread_is_captured_slid_along_held_and_let_fall_at_its_length(run):
    run.feed(PLAN, plan(tool_at(0.5, (0.0, 0.0, 0.4))))
    first = run.states[0]
    (judgement,) = run.carry_out(capture_slide_grasp(0.3, 0.5)).judgements
    assert judgement.verdict is messages.Verdict.HELD
    assert judgement.s_caught == pytest.approx(0.5, abs=0.002)
    assert judgement.slid_m == pytest.approx(0.2 * LENGTH_M, abs=0.5 * MM)
    assert judgement.error_m == pytest.approx(0.4 * MM, abs=0.02 * MM)
    slid = round(0.2 * LENGTH_M / MM)
    assert judgement.sentence == f"grasp held: caught at 50 %, slid {slid} mm; true error 0.4 mm"

    held = run.states[-1]
    assert (first.held, held.held) == (None, pytest.approx(0.5, abs=0.002))
    assert length(held.knots, held.control_points_camera, 3) == pytest.approx(LENGTH_M, rel=0.01)
    at = parameters_at(held.knots, held.control_points_camera, 3, np.array([(held.held or 0) * LENGTH_M]))
    between = (raised(tool_at(0.5), 25.0) @ (0, 0, GRIP_M, 1))[:3]
    assert np.linalg.norm(evaluate(held.knots, held.control_points_camera, 3, at)[0] - between) < 0.3 * MM

    run.carry_out([(raised(tool_at(0.5), 25.0), jaw) for jaw in (0.0, 0.4, 1.0)], plan_id="p2")
    fallen = run.states[-1]
    assert fallen.held is None
    assert length(fallen.knots, fallen.control_points_camera, 3) == pytest.approx(LENGTH_M, rel=0.01)
    assert lifted_mm(fallen) < lifted_mm(first) + 0.2
    assert len(run.judgements) == 1


@pytest.mark.parametrize(
    ("shift_mm", "finding"),
    [
        ((0.0, 6.0, 0.0), "beside the fingers"),
        ((0.0, 0.0, -5.0), "beyond the fingertips"),
        # closing fingers sweep a thread along that lies off their middle
        ((0.0, 2.0, 0.0), ""),
        ((0.0, 0.0, -1.8), ""),
    ],
)
def test_fingers_that_close_beside_the_thread_miss_it(run, shift_mm, finding):
    (judgement,) = run.carry_out(direct(tool_at(0.5, shift_mm))).judgements
    if not finding:
        assert judgement.verdict is messages.Verdict.HELD
        assert judgement.slid_m < 0.5 * MM
        return
    assert (judgement.verdict, judgement.s_caught) == (messages.Verdict.MISSED, None)
    assert judgement.sentence.startswith("grasp missed: the thread lay ")
    assert finding in judgement.sentence
    assert all(state.held is None for state in run.states)
    assert (run.states[-1].control_points_camera == FIELD.control_points_camera).all()


@pytest.mark.parametrize(("drift_mm", "verdict"), [(3.5, messages.Verdict.HELD), (5.0, messages.Verdict.LOST)])
def test_sliding_fingers_keep_what_lies_in_their_partial_opening_and_the_give_of_the_thread(run, drift_mm, verdict):
    # the fingers are 8.2 tan 0.15 = 1.2 mm to either side, and the thread gives way by 3 mm
    drifting = capture_slide_grasp(0.3, 0.5, lambda s: tool_at(s, (0.0, drift_mm * min((s - 0.3) / 0.1, 1.0), 0.0)))
    (judgement,) = run.carry_out(drifting).judgements
    assert judgement.verdict is verdict
    if verdict is messages.Verdict.LOST:
        assert 0 < judgement.slid_m < 0.2 * LENGTH_M
        assert "slipped out" in judgement.sentence
        assert run.states[-1].held is None


def test_a_slide_off_the_end_loses_the_thread(run):
    T = tool_at(1.0)
    off = [(T @ transform(np.eye(3), MM * np.array([k, 0.0, 0.0])), PARTLY) for k in range(6)]
    run.carry_out([*capture_slide_grasp(0.9, 1.0)[:-46], *off, *closing(off[-1][0], PARTLY, 0.0)])
    (judgement,) = run.judgements
    assert judgement.verdict is messages.Verdict.LOST
    assert judgement.slid_m == pytest.approx(0.1 * LENGTH_M, abs=1.5 * MM)
    assert "at 100 %" in judgement.sentence


@pytest.mark.parametrize("then_idle", [False, True])
@pytest.mark.parametrize(("jaw", "finding"), [(0.4, "never closed"), (0.0, "never opened")])
def test_a_plan_that_ends_without_a_grasp_has_missed_and_is_judged_a_little_later(run, jaw, finding, then_idle):
    pose = (tool_at(0.5, (0.0, 0.0, -6.0)), jaw)
    run.carry_out([pose] * 5)
    run.carry_out([pose] * then_idle, plan_id="")
    run.feed(EXECUTION, ended())
    assert run.judgements == []
    assert run.agent.tick_hz == SIMULATOR_STATE.rate_hz
    run.rest()
    (judgement,) = run.judgements
    assert judgement.verdict is messages.Verdict.MISSED
    assert finding in judgement.sentence
    assert run.agent.tick_hz == SIMULATOR_STATE.resting_hz


def test_a_finished_plan_is_judged_once_and_none_that_is_stopped_or_no_plan_at_all(run):
    run.carry_out(direct(tool_at(0.5))[:40], plan_id="")
    assert run.states[-1].held is not None
    run.carry_out(capture_slide_grasp(0.3, 0.5)[:40], plan_id="p2")
    run.feed(EXECUTION, ended("p2", messages.ExecutionKind.HELD, "HOLD_COMMAND"))
    run.rest()
    assert run.judgements == []
    run.carry_out(direct(tool_at(0.5)))
    run.feed(EXECUTION, ended())
    run.rest()
    (judgement,) = run.judgements
    # of a plan that was never heard the error is not known
    assert judgement.error_m is None
    assert "error" not in judgement.sentence


def test_two_arms_hold_the_thread_and_the_second_keeps_it_when_the_first_lets_go(run):
    run.carry_out(direct(tool_at(0.3))[:-26], arm="psm1")
    run.carry_out(direct(tool_at(0.6)), plan_id="p2", arm="psm2")
    assert run.states[-1].held == pytest.approx(0.3, abs=0.002)
    before = run.states[-1].control_points_camera
    run.carry_out([(tool_at(0.3), 1.0)], arm="psm1")
    assert run.states[-1].held == pytest.approx(0.6, abs=0.002)
    assert np.abs(run.states[-1].control_points_camera - before).max() < 0.05 * MM
    assert [judgement.arm for judgement in run.judgements] == ["psm1", "psm2"]


def test_the_same_messages_give_the_same_outputs_byte_for_byte():
    def outputs() -> list[bytes]:
        run = Run(SimulatorConfig(seed=3, background="plain"))
        run.feed(PLAN, plan(tool_at(0.5)))
        return [encode(output.message) for output in run.carry_out(direct(tool_at(0.5))).outputs]

    assert outputs() == outputs()


def verdicts(plans, **errors):
    """What becomes of so many plans of one arm."""
    run = Run(SimulatorConfig(**{**vars(EXACT), **errors}))
    for k in range(plans):
        run.carry_out([*direct(tool_at(0.5)), (raised(tool_at(0.5), 25.0), OPEN)], plan_id=f"p{k}")
    return [judgement.verdict for judgement in run.judgements]


def test_the_tools_error_is_drawn_for_each_plan_with_its_deviation_on_each_axis_and_a_large_one_misses():
    assert {messages.Verdict.HELD, messages.Verdict.MISSED} <= set(verdicts(8, tool_error_mm=3.0))
    drawn = np.array([tool_error(seed, "psm1", "p", 0, 0.7).offset_camera for seed in range(2000)]) / MM
    np.testing.assert_allclose(np.cov(drawn.T), 0.49 * np.eye(3), atol=0.05)
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.05)


def test_registration_is_wrong_by_the_same_in_every_plan_of_an_arm_and_within_its_bounds():
    shifted = [verdicts(2, hand_eye_seed=seed, hand_eye_error_mm=20.0) for seed in range(3)]
    assert all(len(set(one)) == 1 for one in shifted)
    assert [messages.Verdict.MISSED] * 2 in shifted
    about = np.array([0.01, -0.02, 0.09])
    errors = [hand_eye_error(seed, "psm1", 1.5, 1.0, about) for seed in range(50)]
    shifts = np.array([np.linalg.norm(apply(E, about[None])[0] - about) for E in errors])
    turns = np.degrees([np.arccos(np.clip(0.5 * (np.trace(E[:3, :3]) - 1.0), -1.0, 1.0)) for E in errors])
    assert shifts.max() <= 1.5e-3 < 2 * shifts.max()
    assert turns.max() <= 1.0 < 2 * turns.max()
    assert (hand_eye_error(3, "psm1", 0.0, 0.0, about) == np.eye(4)).all()


SHARED = Run()
"""One agent for all examples, since drawing a field takes longer than any of them."""
numbers = st.floats(-0.2, 0.3)
poses = st.tuples(st.tuples(numbers, numbers, numbers), st.tuples(*[st.floats(0.1, 1.0)] * 4), st.floats(-0.698, 1.396))


@settings(max_examples=20)
@given(st.lists(poses, min_size=1, max_size=12))
def test_any_motion_is_followed_and_judged_at_its_end(motions):
    run = SHARED
    run.outputs.clear()
    plan_id = f"p{run.sequence}"
    for position, q, jaw in motions:
        T = transform(rotation_from_quaternion(np.array(q)), np.array(position) * 0.2 + (0.0, 0.0, 0.08))
        run.carry_out([(T, jaw)], plan_id=plan_id)
    run.feed(EXECUTION, ended(plan_id))
    run.rest()
    assert [judgement.plan_id for judgement in run.judgements] == [plan_id]
    assert all(np.isfinite(state.control_points_camera).all() for state in run.states)


def test_the_field_is_told_often_while_an_arm_moves_and_seldom_once_it_has_been_still_for_a_second(run):
    resting, moving = SIMULATOR_STATE.resting_hz, SIMULATOR_STATE.rate_hz
    for jaw, times, told_hz in ((1.0, 1, resting), (0.9, 1, moving), (0.9, 150, resting)):
        run.carry_out(times * [(tool_at(0.5), jaw)])
        assert run.agent.tick_hz == told_hz
