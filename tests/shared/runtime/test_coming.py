"""Outputs that are still worked on when their step is over, of an agent on a real session behind a real router."""

from concurrent.futures import Future
from typing import Any

import pytest

from schemas.codec import encode
from schemas.messages import (
    Consumed,
    FrameStamp,
    Image,
    ImageEncoding,
    StereoFrame,
)
from schemas.topics import FRAMES, HEALTH, PLAN, key
from shared.runtime.agent import Agent, Input, Later, Output
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import declare_publisher
from shared.runtime.progress import ask_progress
from shared.runtime.replay import replay
from tests.shared.runtime.test_replay import Newest, frame, plan, plan_of

IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
NAME, EPOCH = key("test", FRAMES), 5


class Worker(Agent):
    """Answers even frames once the test lets it, and odd ones at once."""

    kind, instance, outputs, commands, tick_hz = "planner", "main", (PLAN,), (), None
    inputs = (Input(FRAMES, only_newest_counts=True),)

    def __init__(self):
        self.work, self.fed = {n: Future() for n in (0, 2)}, []

    def step(self, arrived: Any):
        number = arrived.message.stamp.sequence
        self.fed.append(number)
        if number in self.work:
            yield Later(PLAN, self.work[number])
        else:
            yield Output(PLAN, plan_of(f"frame {number}"))

    def end(self, number):
        self.work[number].set_result(plan_of(f"frame {number}"))


class Rig:
    """A worker, what it said, and the one who feeds it."""

    def __init__(self, session, running, heard, until):
        self.session, self.worker, self.plans = session, Worker(), heard(PLAN)
        self.runner = running(self.worker)
        until(lambda: "planner/main" in ask_progress(session, "test"))
        self.publisher = declare_publisher(session, NAME, FRAMES, waits=True)
        until(lambda: self.publisher.matching_status.matching)

    def feed(self, number):
        """Send the agent a frame."""
        payload = encode(StereoFrame(FrameStamp(number, 0, 0, ""), IMAGE, IMAGE))
        self.publisher.put(payload, attachment=pack(Attachment(EPOCH, number, 0, 0.0)))

    def reasons(self):
        return [plan.reason for plan in self.plans]

    def handled(self):
        return Consumed(NAME, EPOCH, 1) in ask_progress(self.session, "test")["planner/main"].handled


@pytest.fixture
def rig(session, running, heard, until, monkeypatch):
    monkeypatch.setattr("shared.runtime.runner.HEALTH_PERIOD_S", 0.05)
    made = Rig(session, running, heard, until)
    yield made
    made.publisher.undeclare()


def test_a_step_does_not_wait_for_what_is_still_worked_on_and_nothing_is_done_with_before_that(rig, until):
    rig.feed(0)
    until(lambda: rig.worker.fed == [0])
    rig.feed(1)
    until(lambda: rig.reasons() == ["frame 1"])
    assert not rig.handled()
    rig.worker.end(0)
    until(rig.handled)
    until(lambda: rig.reasons() == ["frame 1", "frame 0"])
    # each names what its own step was made from
    assert [[c.sequence for c in plan.consumed if c.key == NAME] for plan in rig.plans] == [[1], [0]]


def test_two_that_are_worked_on_come_in_their_order(rig, until):
    rig.feed(0)
    until(lambda: rig.worker.fed == [0])
    rig.worker.end(2)
    rig.feed(2)
    until(lambda: rig.worker.fed == [0, 2])
    rig.worker.end(0)
    until(lambda: len(rig.plans) == 2)
    assert rig.reasons() == ["frame 0", "frame 2"]


def test_work_that_fails_is_a_fault_that_health_names_and_the_agent_goes_on(rig, heard, until):
    healths = heard(HEALTH)
    rig.feed(0)
    until(lambda: rig.worker.fed == [0])
    rig.worker.work[0].set_exception(ZeroDivisionError("in the work"))
    until(lambda: any("in the work" in health.fault for health in healths))
    rig.feed(1)
    until(lambda: rig.reasons() == ["frame 1"])


def test_an_agent_that_is_stopped_publishes_what_it_still_works_on(rig, until):
    rig.feed(0)
    until(lambda: rig.worker.fed == [0])
    rig.runner.stop()
    rig.worker.end(0)
    until(lambda: rig.reasons() == ["frame 0"])


def test_a_replay_waits_for_it():
    class Working(Worker):
        def step(self, arrived):
            for output in Newest().step(arrived):
                done = Future()
                done.set_result(output.message)
                yield Later(output.topic, done)

    recording = [frame(n) for n in range(3)] + [plan(0, "1 number 0", (1, 1)), plan(1, "3 number 0", (1, 2))]
    assert [replayed.same for replayed in replay(Working, recording)] == [True, False]
