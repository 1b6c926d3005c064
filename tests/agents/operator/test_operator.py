"""The operator against a real planner and a real bridge with a simulated arm, over a real router.

The thread is made by hand: straight, 80 mm away, and known less well in its middle.
"""

import contextlib
import threading

import numpy as np
import pytest

from agents.operator.operator import arm_and_stand_by, ask_for_grasp, hold, prompt
from agents.perception.agent import Perception
from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.codec import decode
from schemas.messages import (
    Arm,
    ExecutionKind,
    Heartbeat,
    Outcome,
    Phase,
    Policy,
    RobotMode,
    RobotState,
    Status,
)
from schemas.topics import COMMANDS, HEARTBEAT, MAIN, PROMPT, ROBOT_STATE
from shared.runtime.agent import Agent, Tick
from shared.runtime.commands import accepted, new_header
from shared.runtime.connection import connected
from shared.runtime.session import SessionSettings

LENGTH_M = 0.04
PATIENT_S = 60.0
NEVER = threading.Event()
LONG_S = 3.5
"""Longer than a command waits for its answer."""


@pytest.fixture(scope="module", autouse=True)
def patient():
    """A test machine may stall."""
    with pytest.MonkeyPatch.context() as patched:
        for name in ("PLAN_WAIT_S", "PLAN_ARRIVES_S", "ARMING_S", "AWAKE_S", "SILENCE_S"):
            patched.setattr(f"agents.operator.operator.{name}", PATIENT_S)
        patched.setattr("agents.operator.operator.new_header", lambda sender: new_header(sender, PATIENT_S))
        patched.setattr("shared.runtime.commands.FARTHEST_DEADLINE_S", 2 * PATIENT_S)
        yield


def patient_planner():
    """For the same reason."""
    return Planner(PlannerConfig(arm_age_ms=1e3 * PATIENT_S))


class Rig:
    """A connection to planner and bridge, the modes that the arm told, and what runs the bridge."""

    def __init__(self, connection, runner):
        self.connection, self.runner, self.modes = connection, runner, []
        connection.listen((ROBOT_STATE,), lambda tapped: self.modes.append(decode(RobotState, tapped.payload).mode))


@pytest.fixture(scope="module")
def opened(router, in_threads, until, hand_made_thread):
    """Open a rig whose bridge goes on for so long without a heartbeat."""

    @contextlib.contextmanager
    def opened(silence_s=PATIENT_S, **settings):
        patient = {"first_heartbeat_s": silence_s, "maximum_plan_age_s": PATIENT_S}
        bridge = RobotBridge(RobotBridgeConfig(dead_man_s=silence_s, **patient, **settings), SimulatedPsm())
        with router() as endpoint:
            session = SessionSettings(rig="test", endpoint=endpoint)
            with (
                in_threads(session, hand_made_thread(), patient_planner(), bridge) as (*_, runner),
                connected(session, PATIENT_S) as connection,
            ):
                rig = Rig(connection, runner)
                until(lambda: rig.modes and ready(connection))
                yield rig

    return opened


@pytest.fixture(scope="module")
def connection(opened):
    """To a rig that no test changes for those that follow."""
    with opened() as rig:
        yield rig.connection


def ready(connection):
    """Whether the planner has seen thread and arm."""
    return ask_for_grasp(connection, "psm1", Policy.DIRECT, s=0.2)[0].outcome is Outcome.ACCEPTED


@pytest.fixture
def planned(until):
    """The plan for a goal; on a busy machine thread or arm may be too old for a while."""

    def ask(connection, policy, **goal):
        def once():
            answer, plan = ask_for_grasp(connection, "psm1", policy, **goal)
            return plan if answer.outcome is Outcome.ACCEPTED else None

        return until(once, "a plan or a rejection")

    return ask


def ended(connection, plan, told=lambda _: None):
    """The event that ended a plan which was armed and stood by."""
    stood = arm_and_stand_by(connection, "psm1", plan.plan_id, NEVER, told)
    assert stood.end is not None, stood
    return stood.end


@pytest.mark.slow
@pytest.mark.parametrize("limits", ["quick"], indirect=True)
def test_a_goal_is_planned_armed_and_carried_out_with_a_slide(opened, limits, planned, until):
    with opened(limits=limits) as rig:
        plan = planned(rig.connection, Policy.CAPTURE_SLIDE_GRASP, s=0.5)
        assert plan.status is Status.OK, plan.reason
        assert plan.s_goal == pytest.approx(0.5)
        assert plan.s_capture is not None
        assert plan.slide_m == pytest.approx(abs(plan.s_capture - 0.5) * LENGTH_M)
        assert plan.slide_m > 0.003
        told = []
        assert ended(rig.connection, plan, told.append).kind is ExecutionKind.FINISHED
        phases = [event.phase for event in told if event.kind is ExecutionKind.PHASE_REACHED]
        assert phases == [Phase.APPROACH, Phase.CAPTURE, Phase.SLIDE, Phase.GRASP, Phase.RETREAT]
        until(lambda: rig.modes[-1] is RobotMode.IDLE)


class Heard:
    """What a bridge asks and what reaches it; `left` is set once so many heartbeats have.

    The bridge is that of an arm that is real, before a camera that films it.
    """

    def __init__(self, connection, enough=5):
        self.connection, self._enough, self.left = connection, enough, threading.Event()
        self.states, self.beats, self.armings = [], [], []
        connection.listen((ROBOT_STATE, HEARTBEAT, COMMANDS), self._take)

    def _take(self, tapped):
        message = decode(tapped.topic.message, tapped.payload)
        if isinstance(message, RobotState):
            self.states.append(message)
        elif isinstance(message, Heartbeat):
            self.beats.append(message)
            if len(self.beats) == self._enough:
                self.left.set()
        elif message.topic.endswith("/arm"):
            self.armings.append(decode(Arm, message.payload))


@pytest.fixture
def heard(settings, real_arm, bridge_of_real_arm, in_threads, until, hand_made_thread, hand_made_camera):
    names = "dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "maximum_frame_age_s"
    bridge = bridge_of_real_arm(real_arm, **dict.fromkeys(names, PATIENT_S))
    agents = hand_made_thread(echoes=True), hand_made_camera(echoes=True), patient_planner(), bridge
    with in_threads(settings, *agents), connected(settings, PATIENT_S) as connection:
        heard = Heard(connection)
        until(lambda: heard.states and ready(connection))
        yield heard


def test_a_process_arms_no_real_arm_and_is_told_why(heard, planned):
    plan = planned(heard.connection, Policy.DIRECT, s=0.2)
    stood = arm_and_stand_by(heard.connection, "psm1", plan.plan_id, NEVER, lambda _: None)
    assert (stood.answer.code, stood.is_real) == ("no_presence", True)
    assert "press the page's button" in stood.answer.reason
    assert heard.beats == []


def test_beside_the_pedal_each_heartbeat_echoes_a_newer_challenge_and_that_of_the_guard(heard, planned, real_arm):
    real_arm.pedal = True
    plan = planned(heard.connection, Policy.DIRECT, s=0.2)
    stood = arm_and_stand_by(heard.connection, "psm1", plan.plan_id, heard.left, lambda _: None)
    assert (stood.answer.outcome, stood.is_real) == (Outcome.ACCEPTED, True), stood
    asked = {state.challenge_ns: state.guard_challenge for state in heard.states}
    (arming,) = heard.armings
    assert arming.challenge_ns in asked
    assert not arming.pressed
    assert all(asked[beat.challenge_ns] == beat.guard_challenge for beat in heard.beats)
    assert not any(beat.pressed for beat in heard.beats)
    answered = [arming.challenge_ns, *(beat.challenge_ns for beat in heard.beats)]
    assert answered == sorted(set(answered))
    assert len(answered) > 5


def test_leaving_disarms_and_the_arm_holds(opened, planned, until):
    with opened(silence_s=0.5) as rig:
        plan = planned(rig.connection, Policy.DIRECT, s=0.2)
        left = threading.Event()
        stood = arm_and_stand_by(rig.connection, "psm1", plan.plan_id, left, lambda _: left.set())
        assert (stood.answer.outcome, stood.end) == (Outcome.ACCEPTED, None)
        assert "disarmed" in stood.left
        until(lambda: rig.modes[-1] is RobotMode.HOLDING)


def test_an_arm_that_falls_silent_is_left(opened, planned, monkeypatch):
    monkeypatch.setattr("agents.operator.operator.SILENCE_S", 0.5)
    with opened() as rig:
        plan = planned(rig.connection, Policy.DIRECT, s=0.2)
        stood = arm_and_stand_by(rig.connection, "psm1", plan.plan_id, NEVER, lambda _: rig.runner.stop())
    assert stood.end is None
    assert "psm1 has not reported" in stood.left


def test_hold_ends_what_an_operator_stands_by(connection, planned):
    plan = planned(connection, Policy.DIRECT, s=0.2)
    held = []

    def hold_once(_):
        if not held:
            # the callback runs in the operator's loop, so the command goes out from elsewhere
            held.append(threading.Thread(target=hold, args=(connection, "psm1"), daemon=True))
            held[0].start()

    end = ended(connection, plan, hold_once)
    held[0].join(PATIENT_S)
    assert (end.kind, end.code) == (ExecutionKind.HELD, "hold_command")


def test_a_pixel_and_a_point_name_the_same_place_as_s(connection, planned):
    point = np.array([-LENGTH_M / 2 + 0.25 * LENGTH_M, 0.0, 0.08])
    pixel = 1000.0 * point[:2] / point[2] + [479.5, 269.5]
    at_s = planned(connection, Policy.DIRECT, s=0.25)
    at_pixel = planned(connection, Policy.DIRECT, pixel=pixel)
    at_point = planned(connection, Policy.DIRECT, point_camera=point)
    assert [plan.s_goal for plan in (at_s, at_pixel, at_point)] == pytest.approx([0.25] * 3, abs=2e-3)


def test_what_cannot_be_done_is_refused_with_a_reason_or_rejected(connection, planned, monkeypatch):
    monkeypatch.setattr("agents.operator.operator.PLAN_ARRIVES_S", 0.2)
    answer, plan = ask_for_grasp(connection, "psm9", Policy.DIRECT, s=0.5)
    assert (answer.outcome, answer.code, plan) == (Outcome.REFUSED, "unknown_arm", None)
    plan = planned(connection, Policy.DIRECT, pixel=np.array([5.0, 5.0]))
    assert plan.status is Status.FAILED
    assert "off the thread" in plan.reason
    stood = arm_and_stand_by(connection, "psm1", "plan-of-nobody", NEVER, lambda _: None)
    assert (stood.answer.code, stood.end) == ("unknown_plan", None)


def test_commands_without_receiver_have_an_unknown_outcome(settings):
    with connected(settings, PATIENT_S) as connection:
        assert hold(connection, "psm1").outcome is Outcome.UNKNOWN
        assert prompt(connection, None).outcome is Outcome.UNKNOWN
        answer, plan = ask_for_grasp(connection, "psm1", Policy.DIRECT, s=0.5)
    assert (answer.outcome, plan) == (Outcome.UNKNOWN, None)
    assert "planner" in answer.reason


class BusyPerception(Agent):
    """In the place of perception with a network that needs longer for a frame than a prompt waits."""

    kind, instance = "perception", MAIN
    inputs, outputs, commands = (), (), (PROMPT,)
    tick_hz = 20.0

    def __init__(self):
        self.busy, self.prompted = threading.Event(), []

    def step(self, arrived):
        if isinstance(arrived, Tick):
            if not self.busy.is_set():
                self.busy.set()
                NEVER.wait(LONG_S)
            return []
        self.prompted.append(arrived.message.pixel.tolist())
        return [accepted(arrived.message.header.id)]


def test_perception_answers_a_prompt(settings, in_threads, until):
    with in_threads(settings, Perception()), connected(settings, PATIENT_S) as connection:
        until(lambda: "perception/main" in connection.present())
        assert prompt(connection, np.array([5.0, 5.0])).code == "no_frame"
        assert prompt(connection, None).outcome is Outcome.ACCEPTED


@pytest.mark.slow
def test_a_prompt_is_told_again_while_perception_is_busy_with_a_frame(settings, in_threads):
    perception = BusyPerception()
    with in_threads(settings, perception), connected(settings, PATIENT_S) as connection:
        assert perception.busy.wait(PATIENT_S)
        assert prompt(connection, np.array([5.0, 6.0])).outcome is Outcome.ACCEPTED
    # one that is told again may be carried out twice, which is as good
    assert {tuple(pixel) for pixel in perception.prompted} == {(5.0, 6.0)}
