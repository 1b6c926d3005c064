"""Replay against small agents whose every rule is known."""

import dataclasses
import random
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from schemas.codec import decode, encode
from schemas.messages import (
    CommandRecord,
    Consumed,
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    GraspGoal,
    GraspPlan,
    Image,
    ImageEncoding,
    Policy,
    RobotMode,
    RobotState,
    Status,
    StereoFrame,
)
from schemas.topics import COMMANDS, EXECUTION, FRAMES, GOAL, PLAN, ROBOT_STATE, key
from shared.runtime.agent import Agent, Input, Output, Received, Tick
from shared.runtime.commands import accepted, new_header
from shared.runtime.outlets import Fed
from shared.runtime.replay import ReplayError, replay

IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
FRAME_KEY, PLAN_KEY = key("test", FRAMES), key("test", PLAN)


@dataclass(frozen=True)
class Entry:
    key: str
    epoch: int
    sequence: int
    payload: bytes
    repeated: bool = False


def frame(number, epoch=1, at=None):
    message = StereoFrame(FrameStamp(number if at is None else at, 0, 0, ""), IMAGE, IMAGE)
    return Entry(FRAME_KEY, epoch, number, encode(message))


def plan_of(reason, consumed=()):
    made = "p", "psm1", "g", FrameStamp(0, 0, 0, ""), Status.FAILED, reason, Policy.DIRECT, None, None, 0.0, 0.0
    return GraspPlan(*made, waypoints=(), alternatives=(), consumed=consumed)


def plan(sequence, reason, *consumed, epoch=9):
    """A recorded plan, made from frames of which epoch and sequence number are given."""
    fed = tuple(Consumed(FRAME_KEY, *place) for place in consumed)
    return Entry(PLAN_KEY, epoch, sequence, encode(plan_of(reason, fed)))


class Summing(Agent):
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


class Newest(Summing):
    """Publishes the number of each frame, whatever came before."""

    inputs = (Input(FRAMES, only_newest_counts=True),)

    def step(self, arrived):
        self.total = 0
        return super().step(arrived)


def test_what_was_consumed_is_fed_once_in_its_order_wherever_it_lies_in_the_recording():
    foreign = Entry(key("test", COMMANDS, agent="robot_bridge"), 1, 0, b"\xff\xff")
    recording = [plan(0, "3 number 0", (1, 3)), foreign, *(frame(n) for n in range(5)), frame(3)]
    recording.append(plan(1, "4 number 0", (1, 1)))
    assert [r.same for r in replay(Summing, recording)] == [True, True]


def test_another_output_is_different_and_so_is_one_that_is_not_made_again():
    recording = [frame(3), plan(0, "4 number 0", (1, 3)), plan(1, "3 number 1", (1, 3))]
    other, none = replay(Summing, recording)
    assert not other.same
    assert other.now is not None
    assert decode(GraspPlan, other.now).reason == "3 number 0"
    assert (other.key, other.epoch, other.sequence) == (PLAN_KEY, 9, 0)
    assert (none.same, none.now) == (False, None)


def test_several_outputs_of_one_step_are_compared_in_their_order():
    recording = [frame(3), frame(4), *(plan(n, f"3 number {n}", (1, 3)) for n in range(2))]
    recording += [plan(n + 2, f"7 number {n}", (1, 4)) for n in range(2)]
    assert [r.same for r in replay(lambda: Summing(each=2), recording)] == [True] * 4


def test_what_a_recording_lacks_is_named_and_costs_an_agent_that_adds_up_all_that_follows():
    recording = [frame(4), plan(0, "3 number 0", (1, 3)), plan(1, "4 number 0", (1, 4))]
    lacking, later = replay(Newest, recording)
    assert (lacking.missing, lacking.now) == ((Consumed(FRAME_KEY, 1, 3),), None)
    assert later.same
    assert [(r.missing, r.same) for r in replay(Summing, recording)] == [((Consumed(FRAME_KEY, 1, 3),), False)] * 2


def test_runs_of_a_publisher_and_of_the_agent_itself_are_told_apart():
    recording = [frame(0, epoch=1, at=10), frame(0, epoch=2, at=20)]
    recording += [
        plan(0, "10 number 0", (1, 0)),
        plan(1, "30 number 0", (2, 0)),
        plan(0, "20 number 0", (2, 0), epoch=10),
    ]
    assert [r.same for r in replay(Summing, recording)] == [True] * 3


class Counting(Agent):
    """Publishes at a goal how many frames it has seen."""

    kind, instance, outputs, commands, tick_hz = "planner", "main", (PLAN,), (GOAL,), None
    inputs = (Input(FRAMES),)
    total = 0

    def step(self, arrived: Any):
        if isinstance(arrived, Received):
            self.total += 1
            return
        yield accepted(arrived.message.header.id)
        yield Output(PLAN, plan_of(f"after {self.total} frames, at {arrived.now_ns}"))


def commanded(topic, received_ns):
    """A recording of a frame, a command, and the plan that followed from both."""
    payload = encode(GraspGoal(new_header("a test"), "psm1", Policy.DIRECT, 0.5, None, None))
    name = key("test", COMMANDS, agent="planner")
    record = CommandRecord(topic, "", payload, received_ns, accepted("id"))
    made = plan_of("after 1 frames, at 5000", (Consumed(FRAME_KEY, 1, 0), Consumed(name, 9, 0)))
    return [frame(0), Entry(name, 9, 0, encode(record)), Entry(PLAN_KEY, 9, 0, encode(made))]


def test_commands_are_replayed_with_the_time_at_which_they_came_and_unknown_ones_are_refused_by_name():
    assert [r.same for r in replay(Counting, commanded(str(GOAL), 5000))] == [True]
    assert [r.same for r in replay(Counting, commanded(str(GOAL), 5001))] == [False]
    with pytest.raises(ReplayError, match="operator/dance"):
        list(replay(Counting, commanded("operator/dance", 5000)))


def run_of(agent, frames, epoch=9):
    """What a run of an agent would leave in a recording, which is fed a frame and, if it ticks, a tick after each."""
    fed, sent, entries = Fed(agent, "test", epoch), dict.fromkeys(agent.outputs, 0), []
    for number in range(frames):
        made = frame(number)
        entries.append(made)
        fed.message(made.key, made.epoch, made.sequence, agent.inputs[0].only_newest_counts)
        outputs = list(agent.step(Received(FRAMES, made.key, made.sequence, decode(StereoFrame, made.payload))))
        if agent.tick_hz is not None:
            fed.tick(1000 + number)
            outputs += agent.step(Tick(1000 + number))
        listed = fed.listed()
        for output in outputs:
            payload = encode(dataclasses.replace(output.message, consumed=listed))
            name = key("test", output.topic, "psm1" if output.topic.per_arm else "main")
            entries.append(Entry(name, epoch, sent[output.topic], payload))
            fed.published(name, sent[output.topic])
            sent[output.topic] += 1
    return entries


class Clockwork(Agent):
    """Adds up ticks and frames; tells the sum at every tick, and at every third once more, as an arm does."""

    kind, instance, outputs, commands, tick_hz = "robot_bridge", "psm1", (ROBOT_STATE, EXECUTION), (), 100.0
    inputs = (Input(FRAMES),)

    def __init__(self):
        self.total, self.ticks = 0, 0

    def step(self, arrived):
        if isinstance(arrived, Received):
            self.total += 100 * arrived.message.stamp.sequence
            return
        self.ticks += 1
        self.total += arrived.now_ns
        yield Output(ROBOT_STATE, state_of(self.total))
        if self.ticks % 3 == 0:
            yield Output(EXECUTION, ExecutionEvent("p", "psm1", self.total, ExecutionKind.FINISHED, None, "", ""))


def state_of(total, consumed=()):
    return RobotState("psm1", total, RobotMode.IDLE, np.eye(4), np.zeros(6), 0.0, np.eye(4), "", consumed)


def test_an_agent_that_acts_on_ticks_is_given_the_same_ticks_again_in_whatever_order_outputs_were_recorded():
    recording = run_of(Clockwork(), 30)
    # what another arm said is left out
    other = [Entry(e.key.replace("psm1", "psm2"), e.epoch, e.sequence, b"\xff") for e in recording if "psm1" in e.key]
    for seed in range(3):
        shuffled = random.Random(seed).sample(other + recording, len(other + recording))
        assert [r.same for r in replay(Clockwork, shuffled)] == [True] * 40


def test_of_two_steps_that_name_the_same_output_before_none_is_left_out():
    before = Consumed(PLAN_KEY, 9, 0)
    made = [plan(n, f"{total} number 0", (1, n)) for n, total in enumerate((0, 1, 3))]
    for number in (1, 2):
        then = decode(GraspPlan, made[number].payload)
        named = encode(dataclasses.replace(then, consumed=(before, *then.consumed)))
        made[number] = dataclasses.replace(made[number], payload=named)
    replayed = list(replay(Summing, [*(frame(n) for n in range(3)), *made]))
    assert [(r.sequence, r.same) for r in replayed] == [(0, True), (1, True), (2, True)]


def test_from_a_lost_output_on_nothing_of_that_run_is_known():
    first, second = run_of(Clockwork(), 30), run_of(Clockwork(), 30, epoch=10)
    lost = next(e for e in first if e.key.endswith("/state") and e.sequence == 9)
    replayed = list(replay(Clockwork, [e for e in first if e is not lost] + second))
    before = [r for r in replayed if r.epoch == 9 and r.same]
    after = [r for r in replayed if r.epoch == 9 and not r.same]
    assert (len(before), len(after)) == (9 + 3, 20 + 7)
    assert {r.missing for r in after} == {(Consumed(lost.key, 9, 9),)}
    assert all(r.same for r in replayed if r.epoch == 10)


class GoingOn(Newest):
    """Publishes the sum of all frames, and goes on from the sum in its last plan."""

    goes_on_from = PLAN

    def step(self, arrived):
        if arrived.topic is PLAN:
            self.total = int(arrived.message.reason)
            return
        self.total += arrived.message.stamp.sequence
        yield Output(PLAN, plan_of(f"{self.total}"))


class OnesMore(GoingOn):
    """Adds one more at each frame: a changed agent."""

    def step(self, arrived):
        self.total += arrived.topic is FRAMES
        yield from super().step(arrived)


@pytest.mark.parametrize("begin", [0, 1, 7, 19])
def test_an_agent_that_goes_on_from_its_last_output_is_replayed_from_anywhere(begin):
    replayed = list(replay(GoingOn, run_of(GoingOn(), 20)[2 * begin :]))
    assert [r.sequence for r in replayed] == list(range(begin, 20))
    if begin:
        lost = replayed.pop(0)
        assert (lost.now, lost.missing) == (None, (Consumed(PLAN_KEY, 9, begin - 1),))
    assert all(r.same and not r.missing for r in replayed)


def test_of_an_agent_that_goes_on_from_its_last_output_a_lost_one_costs_the_next_alone():
    recording = [e for e in run_of(GoingOn(), 20) if (e.key, e.sequence) != (PLAN_KEY, 7)]
    replayed = {r.sequence: r for r in replay(GoingOn, recording)}
    assert replayed[8].missing == (Consumed(PLAN_KEY, 9, 7),)
    assert [n for n, r in replayed.items() if not r.same] == [8]


def reasons(replayed):
    return [int(decode(GraspPlan, r.now).reason) for r in replayed]


def test_a_changed_agent_goes_on_from_the_recorded_state_or_from_its_own():
    recording = run_of(GoingOn(), 6)
    sums = [0, 1, 3, 6, 10, 15]
    assert reasons(replay(OnesMore, recording)) == [s + 1 for s in sums]
    assert reasons(replay(OnesMore, recording, from_own_state=True)) == [s + n + 1 for n, s in enumerate(sums)]
    assert all(r.same for r in replay(GoingOn, recording, from_own_state=True))


def test_after_an_output_that_cannot_be_repeated_it_goes_on_from_the_recorded_one():
    recording = [e for e in run_of(GoingOn(), 6) if (e.key, e.sequence) != (FRAME_KEY, 2)]
    replayed = list(replay(OnesMore, recording, from_own_state=True))
    assert [r.sequence for r in replayed if r.missing] == [2]
    assert reasons(replayed[:2] + replayed[3:]) == [0 + 1, 1 + 2, 6 + 1, 10 + 2, 15 + 3]


def test_what_an_agent_makes_beyond_what_was_recorded_is_counted_and_taken_for_nothing_else():
    # the recorded agent passed over frame 1, which this one answers
    recording = [frame(n) for n in range(5)] + [plan(0, "2 number 0", (1, 1), (1, 2)), plan(1, "4 number 0", (1, 4))]
    assert [(r.same, r.unrecorded) for r in replay(Newest, recording)] == [(True, 1), (True, 0)]


def test_a_step_that_failed_live_fails_again_and_what_follows_is_the_same():
    class Failing(Summing):
        def step(self, arrived):
            if arrived.message.stamp.sequence % 2:
                self.total += 7
                raise ZeroDivisionError("an odd frame")
            return super().step(arrived)

    recording = [frame(1), frame(2), plan(0, "9 number 0", (1, 1), (1, 2))]
    assert [r.same for r in replay(Failing, recording)] == [True]
