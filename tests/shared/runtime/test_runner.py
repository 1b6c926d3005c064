"""Agents on real sessions behind a real router."""

import dataclasses
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import decode, encode
from schemas.messages import (
    AgentHealth,
    CommandHeader,
    CommandRecord,
    FrameStamp,
    GraspGoal,
    GraspPlan,
    Image,
    ImageEncoding,
    LogRecord,
    Outcome,
    Policy,
    Status,
    StereoFrame,
)
from schemas.topics import COMMANDS, FRAMES, GOAL, HEALTH, LOG, PLAN, key
from shared.clock import now_ns
from shared.runtime.agent import Agent, CannotGoOnError, Input, Output, Received, Tick
from shared.runtime.attachment import Attachment, pack
from shared.runtime.commands import FARTHEST_DEADLINE_S, accepted, new_header, refused, send_command, untimely

DEADLINE_S = 60.0
IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
STAMP = FrameStamp(0, 0, 0, "")


class Camera(Agent):
    """Publishes a numbered frame at every tick, or fails for as long as it is told to."""

    kind, instance, inputs, outputs, commands, tick_hz = "camera", "main", (), (FRAMES,), (), 100.0

    def __init__(self):
        self.sent, self.times, self.stumbles, self.closed = 0, [], False, False

    def step(self, arrived):
        assert isinstance(arrived, Tick)
        if self.stumbles:
            raise ValueError("a stone")
        self.times.append(arrived.now_ns)
        yield Output(FRAMES, StereoFrame(FrameStamp(self.sent, arrived.now_ns, arrived.now_ns, ""), IMAGE, IMAGE))
        self.sent += 1

    def close(self):
        self.closed = True


class Planner(Agent):
    """Answers a goal with a rejection, and counts frames and goals."""

    kind, instance, outputs, commands, tick_hz = "planner", "main", (PLAN,), (GOAL,), None

    def __init__(self, **how):
        self.inputs, self.frames, self.goals = (Input(FRAMES, **how),), 0, 0

    def step(self, arrived: Any):
        if isinstance(arrived, Received):
            self.frames += 1
            return
        self.goals += 1
        goal = arrived.message
        if goal.arm == "nobody":
            yield refused(goal.header.id, "unknown_arm", "there is no arm of that name")
            return
        if goal.arm == "bug":
            raise ZeroDivisionError("a name \udcff of bytes, which cannot travel")
        yield accepted(goal.header.id)
        ids = "p", goal.arm, goal.header.id
        yield Output(PLAN, GraspPlan(*ids, STAMP, Status.FAILED, "too far", goal.policy, None, None, 0.0, 0.0, (), ()))


def goal(arm="psm1", **changes):
    header = dataclasses.replace(new_header("a test", DEADLINE_S), **changes)
    return GraspGoal(header, arm, Policy.DIRECT, 0.5, None, None)


@pytest.fixture(autouse=True)
def health_comes_often(monkeypatch):
    monkeypatch.setattr("shared.runtime.runner.HEALTH_PERIOD_S", 0.05)


@pytest.fixture
def ask(session, until):
    """Send a goal once somebody is there to answer; the answer."""

    def send(sent):
        def answered():
            answer = send_command(session, "test", GOAL, sent)
            return answer if answer.outcome is not Outcome.UNKNOWN else None

        return until(answered)

    return send


def test_frames_reach_an_agent_and_none_is_unaccounted(running, heard, until):
    healths: list[AgentHealth] = heard(HEALTH)
    running(Planner())
    running(Camera())
    counted = lambda: [h.inputs[0] for h in healths if h.inputs and h.inputs[0].received > 30]  # noqa: E731
    frames = until(counted)[-1]
    assert (frames.topic, frames.missed, frames.refused) == ("camera/frames", 0, 0)
    assert frames.rate_hz > 10
    assert frames.age_ms is not None
    beats = [health.heartbeat for health in healths if health.agent == "camera"]
    assert beats == sorted(set(beats))


def test_a_command_is_answered_once_published_with_its_answer_and_followed_by_its_outcome(running, heard, ask, until):
    plans: list[GraspPlan] = heard(PLAN)
    records: list[CommandRecord] = heard(COMMANDS)
    planner = Planner()
    running(planner)
    sent = goal()
    answer = ask(sent)
    assert (answer.id, answer.outcome) == (sent.header.id, Outcome.ACCEPTED)
    assert until(lambda: plans)[0].goal_id == sent.header.id
    record = until(lambda: records)[0]
    assert record.answer == answer
    assert decode(GraspGoal, record.payload).header == sent.header
    assert ask(sent) == answer
    assert planner.goals == 1


def test_an_untimely_command_is_refused_and_not_carried_out(running, ask):
    planner = Planner()
    running(planner)
    for deadline_ns, code in ((1, "late"), (now_ns() + 3600 * 10**9, "far_deadline")):
        answer = ask(goal(deadline_ns=deadline_ns))
        assert (answer.outcome, answer.code) == (Outcome.REFUSED, code)
    assert planner.goals == 0


@given(ahead_ns=st.integers(-(2**62), 2**62), received_ns=st.integers(0, 2**62))
def test_a_deadline_holds_from_now_until_a_few_seconds_ahead(ahead_ns, received_ns):
    header = CommandHeader("id", received_ns + ahead_ns, "a test")
    answer = untimely(header, received_ns)
    assert (answer is None) == (0 <= ahead_ns <= round(FARTHEST_DEADLINE_S * 1e9))
    if answer is not None:
        assert (answer.id, answer.code) == ("id", "late" if ahead_ns < 0 else "far_deadline")


def test_a_command_that_is_refused_or_cannot_be_read_is_answered_with_a_code(running, session, ask):
    running(Planner())
    answer = ask(goal("nobody"))
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "unknown_arm")
    (reply,) = session.get(key("test", GOAL), payload=b"\xff\xff", timeout=20.0)
    assert b"unreadable" in reply.ok.payload.to_bytes()


def test_without_a_receiver_the_outcome_is_unknown_and_says_whom_it_asked(session):
    answer = send_command(session, "test", GOAL, goal(), timeout_s=0.5)
    assert answer.outcome is Outcome.UNKNOWN
    assert "planner" in answer.reason


def test_a_step_that_raises_is_a_fault_that_health_names_and_the_agent_goes_on(running, heard, ask, until):
    healths: list[AgentHealth] = heard(HEALTH)
    running(Planner())
    answer = ask(goal("bug"))
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "fault")
    until(lambda: any("ZeroDivisionError: a name" in health.fault for health in healths))
    assert ask(goal()).outcome is Outcome.ACCEPTED


def test_a_fault_holds_until_steps_go_well_again_and_the_log_says_how_many_failed(running, heard, until, monkeypatch):
    monkeypatch.setattr("shared.runtime.accounts.SHOWN_S", 0.1)
    healths: list[AgentHealth] = heard(HEALTH)
    log: list[LogRecord] = heard(LOG)
    camera = Camera()
    camera.stumbles = True
    running(camera)
    until(lambda: any("a stone" in health.fault for health in healths))
    camera.stumbles = False
    until(lambda: healths[-1].fault == "")
    until(lambda: any(r.text.startswith("well again; steps that failed since it began: ") for r in log))
    assert any("a stone" in record.text for record in log)


def test_an_agent_that_cannot_go_on_ends_and_its_log_and_last_health_say_why(running, heard, until):
    class Ending(Camera):
        def step(self, arrived):
            if self.sent == 3:
                raise CannotGoOnError("the cable was pulled")
            yield from super().step(arrived)

    healths: list[AgentHealth] = heard(HEALTH)
    log: list[LogRecord] = heard(LOG)
    camera = Ending()
    runner = running(camera)
    until(lambda: camera.closed)
    assert (runner.gave_up, camera.sent) == ("the cable was pulled", 3)
    until(lambda: any(record.text == "the cable was pulled" for record in log))
    until(lambda: any(health.fault == "the cable was pulled" for health in healths))


def test_damaged_and_foreign_messages_are_refused_counted_and_logged(running, heard, session, until):
    healths: list[AgentHealth] = heard(HEALTH)
    log: list[LogRecord] = heard(LOG)
    planner = Planner()
    running(planner)
    until(lambda: healths)
    frame, beside = encode(StereoFrame(STAMP, IMAGE, IMAGE)), pack(Attachment(1, 0, 0, 0.0))
    damaged = [(b"\xff" * 40, beside), (b"", beside), (frame[:-3], beside), (frame, None), (frame, b"short")]

    def refused_so_far():
        for payload, attachment in damaged:
            session.put(key("test", FRAMES), payload, attachment=attachment)
        return healths[-1].inputs[0].refused >= 5

    until(refused_so_far)
    assert healths[-1].fault == ""
    assert planner.frames == 0
    until(lambda: any("was refused" in record.text for record in log))


def test_only_the_newest_of_an_input_that_says_so_is_listed(running, heard, ask, until):
    plans: list[GraspPlan] = heard(PLAN)
    planner = Planner(only_newest_counts=True)
    running(planner)
    running(Camera())
    until(lambda: planner.frames > 10)
    ask(goal())
    assert [c.key for c in until(lambda: plans)[0].consumed].count(key("test", FRAMES)) == 1


def test_what_is_only_remembered_is_fed_before_a_command_and_as_it_comes_while_the_agent_acts_on_it(
    running, heard, ask, until
):
    class Remembering(Planner):
        """Acts on frames from the first goal on."""

        def acts_on(self, topic):
            return topic is FRAMES and self.goals > 0

    frames, planner = heard(FRAMES), Remembering(only_newest_counts=True, only_remembered=True)
    running(planner)
    running(Camera())
    until(lambda: len(frames) > 10)
    assert planner.frames == 0
    assert ask(goal()).outcome is Outcome.ACCEPTED
    until(lambda: planner.frames > 5)


def test_a_tick_tells_the_time_and_comes_at_its_rate_until_the_agent_is_stopped_and_closed(running, until):
    camera, begun_ns = Camera(), now_ns()
    runner = running(camera)
    until(lambda: len(camera.times) > 30)
    runner.stop()
    until(lambda: camera.closed)
    assert np.diff(camera.times).min() > 0
    assert begun_ns <= camera.times[0] < camera.times[-1] <= now_ns()
    # a busy machine may be slower than the rate, and none is faster
    assert len(camera.times) <= (now_ns() - begun_ns) / 10e6 + 2


def test_ticks_that_take_all_the_time_leave_every_arrival_its_turn(running, ask, until):
    class Busy(Planner):
        tick_hz = 200.0

        def step(self, arrived):
            if isinstance(arrived, Tick):
                threading.Event().wait(0.02)
            else:
                yield from super().step(arrived)

    busy = Busy()
    running(busy)
    running(Camera())
    until(lambda: busy.frames > 5)
    assert ask(goal()).outcome is Outcome.ACCEPTED
