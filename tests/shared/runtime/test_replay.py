"""Replay against small agents whose every rule is known."""

from dataclasses import dataclass

import pytest

from schemas.codec import decode, encode
from schemas.messages import (
    CommandRecord,
    Consumed,
    FrameStamp,
    GraspGoal,
    GraspPlan,
    Image,
    ImageEncoding,
    Outcome,
    Policy,
    Status,
    StereoFrame,
)
from schemas.topics import COMMANDS, FRAMES, GOAL, PLAN, key
from shared.runtime.agent import Input, Output, Received
from shared.runtime.commands import accepted, new_header, send_command
from shared.runtime.replay import ReplayError, replay
from shared.runtime.taps import tap

IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
FRAME_KEY, PLAN_KEY = key("test", FRAMES), key("test", PLAN)


@dataclass(frozen=True)
class Entry:
    key: str
    epoch: int
    sequence: int
    payload: bytes


def frame(number, epoch=1, at=None):
    message = StereoFrame(FrameStamp(number if at is None else at, 0, 0, ""), IMAGE, IMAGE)
    return Entry(FRAME_KEY, epoch, number, encode(message))


def plan_of(reason, consumed=()):
    return GraspPlan(
        plan_id="p",
        arm="psm1",
        goal_id="g",
        stamp=FrameStamp(0, 0, 0, ""),
        status=Status.FAILED,
        reason=reason,
        policy=Policy.DIRECT,
        s_goal=None,
        s_capture=None,
        probability=0.0,
        slide_m=0.0,
        waypoints=(),
        alternatives=(),
        consumed=consumed,
    )


def plan(sequence, reason, *consumed, epoch=9):
    """A recorded plan, made from frames of which epoch and sequence number are given."""
    fed = tuple(Consumed(FRAME_KEY, *place) for place in consumed)
    return Entry(PLAN_KEY, epoch, sequence, encode(plan_of(reason, fed)))


class Summing:
    """Publishes the sum of the numbers of all frames that it was ever fed; `each` times."""

    kind, instance, outputs, commands, tick_hz = "planner", "main", (PLAN,), (), None
    inputs = (Input(FRAMES),)

    def __init__(self, each=1):
        self.total, self.each = 0, each

    def step(self, arrived):
        assert isinstance(arrived, Received)
        self.total += arrived.message.stamp.sequence
        for n in range(self.each):
            yield Output(PLAN, plan_of(f"{self.total} number {n}"))


class Counting:
    """Publishes at a goal how many frames it has seen."""

    kind, instance, outputs, commands, tick_hz = "planner", "main", (PLAN,), (GOAL,), None
    inputs = (Input(FRAMES),)

    def __init__(self):
        self.total = 0

    def step(self, arrived):
        if isinstance(arrived, Received):
            self.total += 1
            return
        yield accepted(arrived.message.header.id)
        yield Output(PLAN, plan_of(f"after {self.total} frames, at {arrived.now_ns}"))


def test_what_was_consumed_is_fed_in_its_order_and_nothing_else():
    recording = [frame(n) for n in range(5)]
    recording += [plan(0, "3 number 0", (1, 3)), plan(1, "4 number 0", (1, 1))]
    assert [r.same for r in replay(Summing, recording)] == [True, True]


def test_the_order_in_the_recording_decides_nothing():
    recording = [plan(0, "3 number 0", (1, 3)), frame(3), frame(1), plan(1, "4 number 0", (1, 1))]
    assert [r.same for r in replay(Summing, recording)] == [True, True]


def test_another_output_is_different_and_both_are_handed_out():
    (replayed,) = replay(Summing, [frame(3), plan(0, "4 number 0", (1, 3))])
    assert not replayed.same
    assert replayed.now is not None
    assert decode(GraspPlan, replayed.now).reason == "3 number 0"
    assert (replayed.key, replayed.epoch, replayed.sequence) == (PLAN_KEY, 9, 0)


def test_an_output_that_is_not_made_again_is_different():
    recording = [frame(3), plan(0, "3 number 0", (1, 3)), plan(1, "3 number 1", (1, 3))]
    first, second = replay(Summing, recording)
    assert first.same
    assert (second.same, second.now) == (False, None)


def test_several_outputs_of_one_step_are_compared_in_their_order():
    recording = [frame(3), frame(4), *(plan(n, f"3 number {n}", (1, 3)) for n in range(2))]
    recording += [plan(n + 2, f"7 number {n}", (1, 4)) for n in range(2)]
    assert [r.same for r in replay(lambda: Summing(each=2), recording)] == [True] * 4


def test_what_a_recording_lacks_is_named_and_the_output_is_neither_the_same_nor_different():
    missing, later = replay(Summing, [frame(4), plan(0, "3 number 0", (1, 3)), plan(1, "4 number 0", (1, 4))])
    assert missing.missing == (Consumed(FRAME_KEY, 1, 3),)
    assert missing.now is None
    assert not later.missing


def test_numbers_of_a_publisher_that_restarted_are_told_apart():
    recording = [frame(0, epoch=1, at=10), frame(0, epoch=2, at=20)]
    recording += [plan(0, "10 number 0", (1, 0)), plan(1, "30 number 0", (2, 0))]
    assert [r.same for r in replay(Summing, recording)] == [True, True]


def test_an_agent_that_restarted_begins_anew():
    recording = [frame(3), frame(4), plan(0, "3 number 0", (1, 3)), plan(0, "4 number 0", (1, 4), epoch=10)]
    assert [r.same for r in replay(Summing, recording)] == [True, True]


def test_a_message_that_is_recorded_twice_is_fed_once():
    recording = [frame(3), frame(3), plan(0, "3 number 0", (1, 3))]
    assert [r.same for r in replay(Summing, recording)] == [True]


def test_what_an_agent_does_not_listen_to_is_not_looked_at():
    foreign = Entry(key("test", COMMANDS, agent="robot_bridge"), 1, 0, b"\xff\xff")
    assert [r.same for r in replay(Summing, [foreign, frame(3), plan(0, "3 number 0", (1, 3))])] == [True]


def test_an_agent_that_acts_on_ticks_is_refused_with_the_reason():
    class Ticking(Summing):
        tick_hz = 60.0

    with pytest.raises(ReplayError, match="planner acts on ticks"):
        list(replay(Ticking, []))


def test_a_command_of_an_unknown_topic_is_refused_by_name():
    record = CommandRecord("operator/dance", "", b"", 0, accepted("id"))
    commands = Entry(key("test", COMMANDS, agent="planner"), 9, 0, encode(record))
    made = plan_of("x", (Consumed(commands.key, 9, 0),))
    with pytest.raises(ReplayError, match="operator/dance"):
        list(replay(Counting, [commands, Entry(PLAN_KEY, 9, 0, encode(made))]))


@pytest.mark.parametrize("only_newest_counts", [False, True])
def test_commands_are_replayed_with_the_time_at_which_they_came(only_newest_counts, running, session, until):
    class Listening(Counting):
        inputs = (Input(FRAMES, only_newest_counts=only_newest_counts),)

    class Newest(Listening):
        """Keeps nothing but whether there was a frame."""

        def step(self, arrived):
            yield from super().step(arrived)
            self.total = min(self.total, 1)

    build = Newest if only_newest_counts else Listening
    heard = []
    kept = tap(session, "test", (FRAMES, PLAN, COMMANDS), heard.append, lambda *_: None)
    planner = build()
    running(planner)
    running(Filming())
    until(lambda: planner.total > (0 if only_newest_counts else 20))

    def goal():
        return GraspGoal(new_header("a test"), "psm1", Policy.DIRECT, 0.5, None, None)

    for _ in range(3):
        assert send_command(session, "test", GOAL, goal()).outcome is Outcome.ACCEPTED
    until(lambda: sum(t.topic is PLAN for t in heard) == 3 == sum(t.topic is COMMANDS for t in heard))
    for declared in kept:
        declared.undeclare()
    recording = [Entry(t.key, t.beside.epoch, t.beside.sequence, t.payload) for t in heard]
    plans = [decode(GraspPlan, t.payload) for t in heard if t.topic is PLAN]
    frames_listed = [sum(c.key == FRAME_KEY for c in made.consumed) for made in plans]
    assert max(frames_listed) == 1 if only_newest_counts else frames_listed[0] > 20
    if only_newest_counts:
        # each can be made again without the ones before it
        assert min(frames_listed) == 1
    assert [r.same for r in replay(build, recording)] == [True] * 3


class Filming:
    kind, instance, inputs, outputs, commands, tick_hz = "camera", "main", (), (FRAMES,), (), 100.0

    def __init__(self):
        self.sent = 0

    def step(self, arrived):
        yield Output(FRAMES, StereoFrame(FrameStamp(self.sent, arrived.now_ns, arrived.now_ns, ""), IMAGE, IMAGE))
        self.sent += 1
