"""Agents on real sessions behind a real router."""

import dataclasses
import threading

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
    Hold,
    Image,
    ImageEncoding,
    LogRecord,
    Outcome,
    Policy,
    Status,
    StereoFrame,
)
from schemas.topics import COMMANDS, FRAMES, GOAL, HEALTH, HOLD, LOG, PLAN, key
from shared.clock import now_ns
from shared.runtime.agent import CannotGoOnError, Command, Input, Output, Received, Tick
from shared.runtime.attachment import Attachment, pack
from shared.runtime.commands import FARTHEST_DEADLINE_S, accepted, new_header, refused, send_command, untimely
from shared.runtime.taps import tap

DEADLINE_S = 60.0
IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))


class Camera:
    """Publishes a numbered frame at every tick."""

    kind, instance, inputs, outputs, commands, tick_hz = "camera", "main", (), (FRAMES,), (), 100.0

    def __init__(self):
        self.sent = 0

    def step(self, arrived):
        yield Output(FRAMES, StereoFrame(FrameStamp(self.sent, arrived.now_ns, arrived.now_ns, ""), IMAGE, IMAGE))
        self.sent += 1


class Planner:
    """Answers a goal with a rejection that tells how many frames it has seen, and keeps count of its steps."""

    kind, instance, outputs, commands, tick_hz = "planner", "main", (PLAN,), (GOAL,), None

    def __init__(self, only_newest_counts=False):
        self.inputs, self.frames, self.goals = (Input(FRAMES, only_newest_counts=only_newest_counts),), 0, 0

    def step(self, arrived):
        if isinstance(arrived, Received):
            self.frames += 1
            return
        assert isinstance(arrived, Command)
        self.goals += 1
        goal = arrived.message
        if goal.arm == "nobody":
            yield refused(goal.header.id, "unknown_arm", "there is no arm of that name")
            return
        if goal.arm == "bug":
            raise ZeroDivisionError("in the step")
        yield accepted(goal.header.id)
        reason = f"after {self.frames} frames"
        yield Output(
            PLAN,
            GraspPlan(
                plan_id=goal.header.id,
                arm=goal.arm,
                goal_id=goal.header.id,
                stamp=FrameStamp(0, 0, 0, ""),
                status=Status.FAILED,
                reason=reason,
                policy=goal.policy,
                s_goal=None,
                s_capture=None,
                probability=0.0,
                slide_m=0.0,
                waypoints=(),
                alternatives=(),
            ),
        )


def goal(arm="psm1", **changes):
    header = dataclasses.replace(new_header("a test", DEADLINE_S), **changes)
    return GraspGoal(header, arm, Policy.DIRECT, 0.5, None, None)


@pytest.fixture
def heard(session):
    """What is published on some topics: a list that fills."""
    kept = []

    def listen(*topics):
        messages = []
        kept.extend(tap(session, "test", topics, messages.append, lambda *_: None))
        return messages

    yield listen
    for declared in kept:
        declared.undeclare()


def test_frames_reach_an_agent_and_none_is_unaccounted(running, heard, until):
    health = heard(HEALTH)
    planner = Planner()
    running(planner)
    running(Camera())

    def account():
        latest = [decode(AgentHealth, t.payload) for t in health if "/planner/" in t.key]
        counted = [h.inputs[0] for h in reversed(latest)]
        return next((i for i in counted if i.received > 50 and i.rate_hz > 10), None)

    frames = until(account)
    assert frames.missed == 0
    assert frames.refused == 0


def test_a_command_is_answered_published_with_its_answer_and_followed_by_its_outcome(running, heard, session, until):
    plans, records = heard(PLAN), heard(COMMANDS)
    running(Planner())
    sent = goal()
    answer = until(lambda: (a := send_command(session, "test", GOAL, sent)).outcome is Outcome.ACCEPTED and a)
    assert answer.id == sent.header.id
    plan = decode(GraspPlan, until(lambda: plans)[0].payload)
    assert plan.goal_id == sent.header.id
    record = decode(CommandRecord, until(lambda: records)[0].payload)
    assert record.answer == answer
    assert decode(GraspGoal, record.payload).header == sent.header


def test_a_command_of_the_same_id_is_carried_out_once(running, session, until):
    planner = Planner()
    running(planner)
    sent = goal()
    first = until(lambda: (a := send_command(session, "test", GOAL, sent)).outcome is Outcome.ACCEPTED and a)
    assert send_command(session, "test", GOAL, sent) == first
    assert planner.goals == 1


def test_a_command_after_its_deadline_is_refused_and_not_carried_out(running, session, until):
    planner = Planner()
    running(planner)
    late = goal(deadline_ns=1)
    answer = until(lambda: (a := send_command(session, "test", GOAL, late)).outcome is not Outcome.UNKNOWN and a)
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "late")
    assert planner.goals == 0


def test_a_command_whose_deadline_lies_far_ahead_is_refused_and_not_carried_out(running, session, until):
    planner = Planner()
    running(planner)
    far = goal(deadline_ns=now_ns() + 3600 * 10**9)
    answer = until(lambda: (a := send_command(session, "test", GOAL, far)).outcome is not Outcome.UNKNOWN and a)
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "far_deadline")
    assert planner.goals == 0


@given(ahead_ns=st.integers(-(2**62), 2**62), received_ns=st.integers(0, 2**62))
def test_a_deadline_holds_from_now_until_a_few_seconds_ahead(ahead_ns, received_ns):
    header = CommandHeader("id", received_ns + ahead_ns, "a test")
    farthest_ns = round(FARTHEST_DEADLINE_S * 1e9)
    answer = untimely(header, received_ns)
    assert (answer is None) == (0 <= ahead_ns <= farthest_ns)
    if answer is not None:
        assert (answer.id, answer.code) == ("id", "late" if ahead_ns < 0 else "far_deadline")


def test_a_refusal_has_a_code_and_a_reason(running, session, until):
    running(Planner())
    answer = until(
        lambda: (a := send_command(session, "test", GOAL, goal("nobody"))).outcome is not Outcome.UNKNOWN and a
    )
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "unknown_arm")


def test_without_a_receiver_the_outcome_is_unknown_and_says_whom_it_asked(session):
    answer = send_command(session, "test", GOAL, goal(), timeout_s=0.5)
    assert answer.outcome is Outcome.UNKNOWN
    assert "planner" in answer.reason


def test_a_command_that_cannot_be_read_is_refused(running, session, until):
    running(Planner())

    def ask():
        replies = session.get(key("test", GOAL), payload=b"\xff\xff", timeout=1.0)
        return next((r.ok.payload.to_bytes() for r in replies if r.ok is not None), None)

    assert b"unreadable" in until(ask)


def test_a_step_that_raises_is_a_fault_that_health_names_and_the_agent_goes_on(running, heard, session, until):
    health = heard(HEALTH)
    running(Planner())
    answer = until(lambda: (a := send_command(session, "test", GOAL, goal("bug"))).outcome is not Outcome.UNKNOWN and a)
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "fault")
    until(lambda: any("ZeroDivisionError" in decode(AgentHealth, t.payload).fault for t in health))
    until(lambda: send_command(session, "test", GOAL, goal()).outcome is Outcome.ACCEPTED)


class Stumbling(Camera):
    """Raises for as long as it is told to."""

    stumbles = True

    def step(self, arrived):
        if self.stumbles:
            raise ValueError("a stone")
        yield from super().step(arrived)


def test_a_fault_holds_until_steps_go_well_again_and_the_log_says_how_many_failed(running, heard, until, monkeypatch):
    monkeypatch.setattr("shared.runtime.faults.SHOWN_S", 0.1)
    health, log = heard(HEALTH), heard(LOG)
    agent = Stumbling()
    running(agent)

    def told():
        return [decode(AgentHealth, t.payload).fault for t in health]

    until(lambda: any("a stone" in fault for fault in told()))
    agent.stumbles = False
    until(lambda: told()[-1] == "")
    texts = [decode(LogRecord, t.payload).text for t in log]
    assert sum("a stone" in text for text in texts) >= 1
    assert any(text.startswith("well again; steps that failed since it began: ") for text in texts)


class Ending(Camera):
    """Breaks off after a few frames."""

    def __init__(self):
        super().__init__()
        self.closed = False

    def step(self, arrived):
        if self.sent == 3:
            raise CannotGoOnError("the cable was pulled")
        yield from super().step(arrived)

    def close(self):
        self.closed = True


def test_an_agent_that_cannot_go_on_ends_and_its_log_and_last_health_say_why(running, heard, until):
    health, log = heard(HEALTH), heard(LOG)
    agent = Ending()
    runner = running(agent)
    until(lambda: agent.closed)
    assert (runner.gave_up, agent.sent) == ("the cable was pulled", 3)
    until(lambda: any(decode(LogRecord, t.payload).text == "the cable was pulled" for t in log))
    until(lambda: any(decode(AgentHealth, t.payload).fault == "the cable was pulled" for t in health))


def test_damaged_and_foreign_messages_are_refused_counted_and_logged(running, heard, session, until):
    health, log = heard(HEALTH), heard(LOG)
    planner = Planner()
    running(planner)
    frames = key("test", FRAMES)
    until(lambda: health)
    frame = encode(StereoFrame(FrameStamp(0, 0, 0, ""), IMAGE, IMAGE))
    beside = pack(Attachment(1, 0, 0, 0.0))
    damaged = [(b"\xff" * 40, beside), (b"", beside), (frame[:-3], beside), (frame, None), (frame, b"short")]

    def refused_so_far():
        for payload, attachment in damaged:
            session.put(frames, payload, attachment=attachment)
        return [h for t in health if (h := decode(AgentHealth, t.payload)).inputs and h.inputs[0].refused >= 5]

    assert until(refused_so_far)[-1].fault == ""
    assert planner.frames == 0
    assert any("was refused" in decode(LogRecord, t.payload).text for t in log)


def test_health_counts_turns_of_the_loop_itself(running, heard, until):
    health = heard(HEALTH)
    running(Camera())
    until(lambda: len(health) >= 3)
    beats = [decode(AgentHealth, t.payload).heartbeat for t in health]
    assert beats == sorted(set(beats))


def test_only_the_newest_of_an_input_that_says_so_is_listed(running, heard, session, until):
    plans = heard(PLAN)
    planner = Planner(only_newest_counts=True)
    running(planner)
    running(Camera())
    until(lambda: planner.frames > 20)
    until(lambda: send_command(session, "test", GOAL, goal()).outcome is Outcome.ACCEPTED)
    plan = decode(GraspPlan, until(lambda: plans)[0].payload)
    assert len([c for c in plan.consumed if c.key == key("test", FRAMES)]) == 1


class Remembering(Planner):
    """Remembers frames, and acts on them from the first goal on."""

    def __init__(self):
        super().__init__()
        self.inputs = (Input(FRAMES, only_newest_counts=True, only_remembered=True),)

    def acts_on(self, topic):
        return topic is FRAMES and self.goals > 0


def test_what_is_only_remembered_is_fed_before_a_command_and_as_it_comes_while_the_agent_acts_on_it(
    running, heard, session, until
):
    frames, planner, camera = heard(FRAMES), Remembering(), Camera()
    running(planner)
    running(camera)
    until(lambda: len(frames) > 10)
    assert planner.frames == 0
    assert send_command(session, "test", GOAL, goal()).outcome is Outcome.ACCEPTED
    until(lambda: planner.frames > 5)


def test_a_tick_tells_the_time_and_comes_at_its_rate(running, until):
    class Clock:
        kind, instance, inputs, outputs, commands, tick_hz = "camera", "main", (), (), (), 50.0
        ticks = ()

        def step(self, arrived):
            assert isinstance(arrived, Tick)
            self.ticks = (*self.ticks, arrived.now_ns)
            return ()

    clock = Clock()
    begun_ns = now_ns()
    running(clock)
    ticks = until(lambda: len(clock.ticks) > 30 and clock.ticks)
    assert np.diff(ticks).min() > 0
    # a busy machine may be slower than the rate, and none is faster
    assert len(ticks) <= (now_ns() - begun_ns) / 20e6 + 2


def test_ticks_that_take_all_the_time_leave_every_arrival_its_turn(running, session, until):
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
    until(lambda: send_command(session, "test", GOAL, goal()).outcome is Outcome.ACCEPTED)


def test_a_failure_whose_text_cannot_travel_is_told_all_the_same(running, heard, session, until):
    class Unspeakable(Planner):
        def step(self, arrived):
            raise OSError(f"a name \udcff of bytes in {type(arrived).__name__}")

    health = heard(HEALTH)
    running(Unspeakable())
    answer = until(lambda: (a := send_command(session, "test", GOAL, goal())).outcome is not Outcome.UNKNOWN and a)
    assert answer.code == "fault"
    until(lambda: any("a name" in decode(AgentHealth, t.payload).fault for t in health))


def test_an_agent_is_closed_when_its_run_ends(running, until):
    class Closed(Camera):
        closed = False

        def close(self):
            self.closed = True

    camera = Closed()
    runner = running(camera)
    until(lambda: camera.sent > 2)
    runner.stop()
    until(lambda: camera.closed)


def test_stopping_is_carried_out_whatever_its_deadline(running, session, until):
    class Bridge:
        kind, instance, inputs, outputs, commands, tick_hz = "robot_bridge", "psm1", (), (), (HOLD,), None
        holds = 0

        def step(self, arrived):
            self.holds += 1
            yield accepted(arrived.message.header.id)

    bridge = Bridge()
    running(bridge)
    for holds, deadline_ns in enumerate((1, 2**62), start=1):
        untimely_hold = Hold(dataclasses.replace(new_header("a test"), deadline_ns=deadline_ns), "psm1")
        until(lambda hold=untimely_hold: send_command(session, "test", HOLD, hold, "psm1").outcome is Outcome.ACCEPTED)
        assert bridge.holds == holds
