"""Agents on real sessions behind a real router."""

import dataclasses
import threading
from concurrent.futures import Future
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import decode
from schemas.messages import CommandHeader, Consumed, FrameStamp, GraspGoal, Outcome, Policy, StereoFrame
from schemas.topics import COMMANDS, FRAMES, GOAL, HEALTH, LOG, PLAN, key
from shared.clock import now_ns
from shared.runtime.agent import Agent, CannotGoOnError, Input, Later, Output, Received, Tick
from shared.runtime.commands import FARTHEST_DEADLINE_S, accepted, new_header, refused, send_command, untimely
from shared.runtime.delivery import declare_publisher
from shared.runtime.facts import ask_progress
from tests.shared.runtime.conftest import IMAGE, beside, frame_bytes, rejection

DEADLINE_S, NAME = 60.0, key("test", FRAMES)


class Camera(Agent):
    """Publishes a numbered frame at every tick, or fails for as long as it is told to."""

    kind, outputs, tick_hz = "camera", (FRAMES,), 100.0

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

    kind, outputs, commands = "planner", (PLAN,), (GOAL,)

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
        yield Output(PLAN, rejection("too far", goal_id=goal.header.id))


def goal(arm="psm1", **changes):
    header = dataclasses.replace(new_header("a test", DEADLINE_S), **changes)
    return GraspGoal(header, arm, Policy.DIRECT, 0.5, None, None)


@pytest.fixture
def ask(session, until):
    """Send a goal once somebody is there to answer; the answer."""

    def send(sent):
        def answered():
            answer = send_command(session, "test", GOAL, sent)
            return answer if answer.outcome is not Outcome.UNKNOWN else None

        return until(answered)

    return send


def test_ticks_tell_the_time_at_their_rate_and_frames_reach_an_agent_and_none_is_unaccounted(running, heard, until):
    healths, camera, begun_ns = heard(HEALTH), Camera(), now_ns()
    running(Planner())
    runner = running(camera)
    frames = until(lambda: [h.inputs[0] for h in healths if h.inputs and h.inputs[0].received > 30])[-1]
    assert (frames.topic, frames.missed, frames.refused) == ("camera/frames", 0, 0)
    assert frames.rate_hz > 10
    assert frames.age_ms is not None
    beats = [health.heartbeat for health in healths if health.agent == "camera"]
    assert beats == sorted(set(beats))
    runner.stop()
    until(lambda: camera.closed)
    assert np.diff(camera.times).min() > 0
    assert begun_ns <= camera.times[0] < camera.times[-1] <= now_ns()
    # a busy machine may be slower than the rate, and none is faster
    assert len(camera.times) <= (now_ns() - begun_ns) / 10e6 + 2


def test_a_command_is_answered_once_and_published_or_refused_with_a_code(running, session, heard, ask, until):
    plans, records, healths, planner, sent = heard(PLAN), heard(COMMANDS), heard(HEALTH), Planner(), goal()
    running(planner)
    answer = ask(sent)
    assert (answer.id, answer.outcome) == (sent.header.id, Outcome.ACCEPTED)
    assert until(lambda: plans)[0].goal_id == sent.header.id
    record = until(lambda: records)[0]
    assert record.answer == answer
    assert decode(GraspGoal, record.payload).header == sent.header
    assert ask(sent) == answer
    for other, code in (
        (goal(deadline_ns=1), "late"),
        (goal(deadline_ns=now_ns() + 3600 * 10**9), "far_deadline"),
        (goal("nobody"), "unknown_arm"),
        (goal("bug"), "fault"),
    ):
        answer = ask(other)
        assert (answer.outcome, answer.code) == (Outcome.REFUSED, code)
    (reply,) = session.get(key("test", GOAL), payload=b"\xff\xff", timeout=20.0)
    assert b"unreadable" in reply.ok.payload.to_bytes()
    # a step that raises is a fault that health names, and the agent goes on
    until(lambda: any("ZeroDivisionError: a name" in health.fault for health in healths))
    assert ask(goal()).outcome is Outcome.ACCEPTED
    assert planner.goals == 4


@given(ahead_ns=st.integers(-(2**62), 2**62), received_ns=st.integers(0, 2**62))
def test_a_deadline_holds_from_now_until_a_few_seconds_ahead(ahead_ns, received_ns):
    answer = untimely(CommandHeader("id", received_ns + ahead_ns, "a test"), received_ns)
    assert (answer is None) == (0 <= ahead_ns <= round(FARTHEST_DEADLINE_S * 1e9))
    if answer is not None:
        assert (answer.id, answer.code) == ("id", "late" if ahead_ns < 0 else "far_deadline")


def test_without_a_receiver_the_outcome_is_unknown_and_says_whom_it_asked(session):
    answer = send_command(session, "test", GOAL, goal(), timeout_s=0.5)
    assert answer.outcome is Outcome.UNKNOWN
    assert "planner" in answer.reason


def test_a_fault_holds_until_steps_go_well_again_and_the_log_says_how_many_failed(running, heard, until, monkeypatch):
    monkeypatch.setattr("shared.runtime.accounts.SHOWN_S", 0.1)
    healths, log, camera = heard(HEALTH), heard(LOG), Camera()
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

    healths, log, camera = heard(HEALTH), heard(LOG), Ending()
    runner = running(camera)
    until(lambda: camera.closed)
    assert (runner.gave_up, camera.sent) == ("the cable was pulled", 3)
    until(lambda: any(record.text == "the cable was pulled" for record in log))
    until(lambda: any(health.fault == "the cable was pulled" for health in healths))


def test_what_is_only_remembered_is_fed_before_what_the_agent_acts_on(running, heard, ask, until):
    class Remembering(Planner):
        """Acts on frames from the first goal on."""

        def acts_on(self, topic):
            return topic is FRAMES and self.goals > 0

    frames, plans, planner = heard(FRAMES), heard(PLAN), Remembering(only_newest_counts=True, only_remembered=True)
    running(planner)
    running(Camera())
    until(lambda: len(frames) > 10)
    assert planner.frames == 0
    assert ask(goal()).outcome is Outcome.ACCEPTED
    until(lambda: planner.frames > 5)
    assert ask(goal()).outcome is Outcome.ACCEPTED
    # the newest alone is listed of an input that says so
    assert [[c.key for c in plan.consumed].count(NAME) for plan in until(lambda: plans[1:] and plans)] == [1, 1]


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


class Worker(Agent):
    """Answers even frames once the test lets it, and odd ones at once."""

    kind, outputs, inputs = "planner", (PLAN,), (Input(FRAMES, only_newest_counts=True),)

    def __init__(self):
        self.work, self.fed = {n: Future() for n in (0, 2)}, []

    def step(self, arrived: Any):
        number = arrived.message.stamp.sequence
        self.fed.append(number)
        if number in self.work:
            yield Later(PLAN, self.work[number])
        else:
            yield Output(PLAN, rejection(f"frame {number}"))

    def end(self, number):
        self.work[number].set_result(rejection(f"frame {number}"))


class Fed:
    """A worker, what it said, and the one who feeds it."""

    def __init__(self, session, running, heard, keep, until):
        self.until, self.worker, self.plans = until, Worker(), heard(PLAN)
        self.runner = running(self.worker)
        self.told = lambda: ask_progress(session, "test")
        until(lambda: "planner/main" in self.told())
        self.publisher = keep(declare_publisher(session, NAME, FRAMES, waits=True))
        until(lambda: self.publisher.matching_status.matching)

    def feed(self, number):
        """Send the agent a frame; it is in its step then, or has been."""
        self.publisher.put(frame_bytes(number), attachment=beside(number, epoch=5))
        self.until(lambda: number in self.worker.fed)

    def says(self, *numbers):
        self.until(lambda: [plan.reason for plan in self.plans] == [f"frame {number}" for number in numbers])

    def handled(self, number):
        return Consumed(NAME, 5, number) in self.told()["planner/main"].handled


@pytest.fixture
def fed(session, running, heard, keep, until):
    return Fed(session, running, heard, keep, until)


def test_a_step_does_not_wait_for_what_is_still_worked_on_and_nothing_is_done_with_before_that(fed, heard, until):
    healths = heard(HEALTH)
    fed.feed(0)
    fed.feed(1)
    fed.says(1)
    assert not fed.handled(1)
    fed.worker.end(0)
    until(lambda: fed.handled(1))
    fed.says(1, 0)
    # each names what its own step was made from
    assert [[c.sequence for c in plan.consumed if c.key == NAME] for plan in fed.plans] == [[1], [0]]
    # work that fails is a fault that health names, and the agent goes on
    fed.feed(2)
    fed.worker.work[2].set_exception(ZeroDivisionError("in the work"))
    until(lambda: any("in the work" in health.fault for health in healths))
    fed.feed(3)
    fed.says(1, 0, 3)


def test_two_that_are_worked_on_come_in_their_order_even_where_the_agent_is_stopped_meanwhile(fed):
    fed.feed(0)
    fed.worker.end(2)
    fed.feed(2)
    fed.runner.stop()
    fed.worker.end(0)
    fed.says(0, 2)
