"""The operator against a real planner and a real bridge, over a real router."""

import contextlib
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.operator.operator import arm_and_stand_by, ask_for_grasp, hold, prompt
from agents.perception.agent import Perception
from schemas.codec import decode
from schemas.messages import (
    Arm,
    CommandAnswer,
    ExecutionKind,
    Heartbeat,
    Outcome,
    Phase,
    Policy,
    RobotMode,
    RobotState,
    Status,
)
from schemas.topics import COMMANDS, HEARTBEAT, ROBOT_STATE
from shared.runtime.commands import new_header
from shared.runtime.connection import connected
from shared.runtime.session import SessionSettings
from tests.agents.operator.by_hand import (
    LENGTH_M,
    PATIENT_S,
    QUICK,
    HandMadeCamera,
    HandMadeThread,
    RealPsm,
    patient_bridge,
    patient_planner,
)

NEVER = threading.Event()
TASKS = Path("/proc/self/task")


@pytest.fixture(scope="module", autouse=True)
def patient_operator():
    """A test machine may stall."""
    with pytest.MonkeyPatch.context() as patched:
        for name in ("PLAN_WAIT_S", "PLAN_ARRIVES_S", "ARMING_S", "AWAKE_S", "SILENCE_S"):
            patched.setattr(f"agents.operator.operator.{name}", PATIENT_S)
        patched.setattr("agents.operator.operator.new_header", lambda sender: new_header(sender, PATIENT_S))
        patched.setattr("shared.runtime.commands.FARTHEST_DEADLINE_S", 2 * PATIENT_S)
        yield


class Rig:
    """A connection to planner and bridge, what runs the bridge, what it asks, and what reaches it.

    Fields:
        left: set once five heartbeats have.
    """

    def __init__(self, connection, runner):
        self.connection, self.runner, self.left = connection, runner, threading.Event()
        self.states, self.beats, self.armings = [], [], []
        connection.listen((ROBOT_STATE, HEARTBEAT, COMMANDS), self._take)

    def _take(self, tapped):
        message = decode(tapped.topic.message, tapped.payload)
        if isinstance(message, RobotState):
            self.states.append(message)
        elif isinstance(message, Heartbeat):
            self.beats.append(message)
            if len(self.beats) == 5:
                self.left.set()
        elif message.topic.endswith("/arm"):
            self.armings.append(decode(Arm, message.payload))

    def is_planned(self):
        """Whether the planner has seen thread and arm."""
        return self.states and ask_for_grasp(self.connection, "psm1", Policy.DIRECT, s=0.2)[1] is not None

    def stands_by(self, plan, left=NEVER, told=lambda _: None):
        return arm_and_stand_by(self.connection, "psm1", plan.plan_id, left, told)


@pytest.fixture(scope="module")
def opened(router, in_threads, until):
    """Open a rig with this arm, where each frame echoes challenges."""

    @contextlib.contextmanager
    def opened(arm=None, **config):
        bridge = patient_bridge(arm, **config)
        agents = HandMadeThread(echoes=True), HandMadeCamera(echoes=True), patient_planner(), bridge
        with router() as endpoint:
            session = SessionSettings(rig="test", endpoint=endpoint)
            with in_threads(session, *agents) as (*_, runner), connected(session, PATIENT_S) as connection:
                rig = Rig(connection, runner)
                until(rig.is_planned)
                yield rig

    return opened


@pytest.fixture(scope="module")
def rig(opened):
    """One that no test changes for those that follow."""
    with opened() as rig:
        yield rig


@pytest.fixture
def planned(until):
    """The plan for a goal; on a busy machine thread or arm may be too old for a while."""

    def ask(rig, policy=Policy.DIRECT, **goal):
        def once():
            answer, plan = ask_for_grasp(rig.connection, "psm1", policy, **goal)
            return plan if answer.outcome is Outcome.ACCEPTED else None

        return until(once, "a plan or a rejection")

    return ask


@pytest.mark.slow
def test_a_goal_is_planned_armed_and_carried_out_with_a_slide(opened, planned, until):
    with opened(limits=QUICK) as rig:
        plan = planned(rig, Policy.CAPTURE_SLIDE_GRASP, s=0.5)
        assert (plan.status, plan.s_goal) == (Status.OK, pytest.approx(0.5)), plan.reason
        assert plan.slide_m == pytest.approx(abs(plan.s_capture - 0.5) * LENGTH_M)
        assert plan.slide_m > 0.003
        told = []
        stood = rig.stands_by(plan, told=told.append)
        assert (stood.is_real, stood.end.kind) == (False, ExecutionKind.FINISHED)
        phases = [event.phase for event in told if event.kind is ExecutionKind.PHASE_REACHED]
        assert phases == [Phase.APPROACH, Phase.CAPTURE, Phase.SLIDE, Phase.GRASP, Phase.RETREAT]
        until(lambda: rig.states[-1].mode is RobotMode.IDLE)


def test_a_pixel_and_a_point_name_the_same_place_as_s(rig, planned):
    point = np.array([-LENGTH_M / 2 + 0.25 * LENGTH_M, 0.0, 0.08])
    pixel = 1000.0 * point[:2] / point[2] + [479.5, 269.5]
    goals = {"s": 0.25}, {"pixel": pixel}, {"point_camera": point}
    assert [planned(rig, **goal).s_goal for goal in goals] == pytest.approx([0.25] * 3, abs=2e-3)


def test_what_cannot_be_done_is_refused_with_a_reason_or_rejected(rig, planned, monkeypatch):
    monkeypatch.setattr("agents.operator.operator.PLAN_ARRIVES_S", 0.2)
    answer, plan = ask_for_grasp(rig.connection, "psm9", Policy.DIRECT, s=0.5)
    assert (answer.outcome, answer.code, plan) == (Outcome.REFUSED, "unknown_arm", None)
    plan = planned(rig, pixel=np.array([5.0, 5.0]))
    assert plan.status is Status.FAILED
    assert "off the thread" in plan.reason
    stood = arm_and_stand_by(rig.connection, "psm1", "plan-of-nobody", NEVER, lambda _: None)
    assert (stood.answer.code, stood.end) == ("unknown_plan", None)


def test_hold_ends_what_an_operator_stands_by(rig, planned):
    holding = threading.Thread(target=lambda: hold(rig.connection, "psm1"), daemon=True)
    # the callback runs in the operator's loop, so the command goes out from elsewhere
    stood = rig.stands_by(planned(rig, s=0.2), told=lambda _: None if holding.ident else holding.start())
    holding.join(PATIENT_S)
    assert (stood.end.kind, stood.end.code) == (ExecutionKind.HELD, "hold_command")


def test_a_process_arms_a_real_arm_beside_the_pedal_alone_and_each_heartbeat_echoes_a_newer_challenge(opened, planned):
    arm = RealPsm()
    with opened(arm) as rig:
        stood = rig.stands_by(planned(rig, s=0.2))
        assert (stood.answer.code, stood.is_real, rig.beats) == ("no_presence", True, [])
        assert "press the page's button" in stood.answer.reason
        arm.pedal = True
        stood = rig.stands_by(planned(rig, s=0.2), left=rig.left)
        assert (stood.answer.outcome, stood.is_real) == (Outcome.ACCEPTED, True), stood
        asked = {state.challenge_ns: state.guard_challenge for state in rig.states}
        arming = rig.armings[-1]
        assert arming.challenge_ns in asked
        assert all(asked[beat.challenge_ns] == beat.guard_challenge for beat in rig.beats)
        assert not any(said.pressed for said in (arming, *rig.beats))
        answered = [arming.challenge_ns, *(beat.challenge_ns for beat in rig.beats)]
        assert answered == sorted(set(answered))
        assert len(answered) > 5


def test_leaving_disarms_and_the_arm_holds(opened, planned, until):
    with opened(dead_man_s=0.5, first_heartbeat_s=0.5) as rig:
        left = threading.Event()
        stood = rig.stands_by(planned(rig, s=0.2), left, lambda _: left.set())
        assert (stood.answer.outcome, stood.end) == (Outcome.ACCEPTED, None)
        assert "disarmed" in stood.left
        until(lambda: rig.states[-1].mode is RobotMode.HOLDING)


def test_an_arm_that_falls_silent_is_left(opened, planned, monkeypatch):
    monkeypatch.setattr("agents.operator.operator.SILENCE_S", 0.5)
    with opened() as rig:
        stood = rig.stands_by(planned(rig, s=0.2), told=lambda _: rig.runner.stop())
    assert stood.end is None
    assert "psm1 has not reported" in stood.left


def test_commands_without_receiver_have_an_unknown_outcome(settings):
    with connected(settings, PATIENT_S) as connection:
        assert hold(connection, "psm1").outcome is Outcome.UNKNOWN
        assert prompt(connection, None).outcome is Outcome.UNKNOWN
        answer, plan = ask_for_grasp(connection, "psm1", Policy.DIRECT, s=0.5)
    assert (answer.outcome, plan) == (Outcome.UNKNOWN, None)
    assert "planner" in answer.reason


def test_what_is_asked_again_and_again_leaves_nothing_that_listens(settings, until):
    with connected(settings) as connection:
        ask_for_grasp(connection, "psm1", Policy.DIRECT, s=0.5)
        before = len(list(TASKS.iterdir()))
        for _ in range(20):
            ask_for_grasp(connection, "psm1", Policy.DIRECT, s=0.5)
        until(lambda: len(list(TASKS.iterdir())) <= before + 2, "threads of listeners to end")


def test_perception_answers_a_prompt(settings, in_threads, until):
    with in_threads(settings, Perception()), connected(settings, PATIENT_S) as connection:
        until(lambda: "perception/main" in connection.present())
        assert prompt(connection, np.array([5.0, 5.0])).code == "no_frame"
        assert prompt(connection, None).outcome is Outcome.ACCEPTED


def test_a_prompt_is_told_again_while_perception_is_too_busy_to_hear_it_in_time():
    told, codes = [], ["unknown_id", "late", ""]

    def command(_topic, message):
        told.append(message)
        code = codes.pop(0)
        return CommandAnswer(message.header.id, Outcome.UNKNOWN if code else Outcome.ACCEPTED, code, code)

    busy: Any = SimpleNamespace(command=command)
    assert prompt(busy, np.array([5.0, 6.0])).outcome is Outcome.ACCEPTED
    assert [message.pixel.tolist() for message in told] == [[5.0, 6.0]] * 3
    assert len({message.header.id for message in told}) == 3
