"""Replay against small agents whose every rule is known, and what an output lists of what its agent was fed."""

import dataclasses
import random
from collections.abc import Iterable
from concurrent.futures import Future
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
    Policy,
    RobotMode,
    RobotState,
    StereoFrame,
)
from schemas.topics import COMMANDS, EXECUTION, FRAMES, GOAL, PLAN, ROBOT_STATE, TOPICS, key
from shared.recording.entry import Entry as Recorded
from shared.runtime.agent import Agent, Input, Later, Output, Received, Tick
from shared.runtime.commands import accepted, new_header
from shared.runtime.outlets import MOST_LISTED, OMITTED, TICK, Fed, is_tick
from shared.runtime.replay import ReplayError, replay
from tests.shared.runtime.conftest import IMAGE, Idle, rejection

FRAME_KEY, PLAN_KEY, STATE_KEY = key("test", FRAMES), key("test", PLAN), key("test", ROBOT_STATE, "psm1")


def entry(name, epoch, sequence, payload):
    return Recorded(name, epoch, sequence, payload, 0, 0)


def frame(number, epoch=1, at=None):
    stamp = FrameStamp(number if at is None else at, 0, 0, "")
    return entry(FRAME_KEY, epoch, number, encode(StereoFrame(stamp, IMAGE, IMAGE)))


def plan(sequence, reason, *consumed, epoch=9):
    """A recorded plan, made from frames of which epoch and sequence number are given."""
    fed = tuple(Consumed(FRAME_KEY, *place) for place in consumed)
    return entry(PLAN_KEY, epoch, sequence, encode(rejection(str(reason), fed)))


def same(replayed):
    return [one.same for one in replayed]


class Summing(Agent):
    """Publishes the sum of the numbers of all frames that it was ever fed."""

    kind, outputs, inputs = "planner", (PLAN,), (Input(FRAMES),)

    def __init__(self):
        self.total = 0

    def step(self, arrived) -> Iterable[Any]:
        assert isinstance(arrived, Received)
        self.total += arrived.message.stamp.sequence
        yield Output(PLAN, rejection(f"{self.total}"))


class Newest(Summing):
    """Publishes the number of each frame, whatever came before, once its work is done."""

    inputs = (Input(FRAMES, only_newest_counts=True),)

    def step(self, arrived):
        self.total, done = 0, Future()
        (output,) = super().step(arrived)
        done.set_result(output.message)
        yield Later(output.topic, done)


def test_what_was_consumed_is_fed_once_in_its_order_wherever_it_lies_and_runs_are_told_apart():
    foreign = entry(key("test", COMMANDS, agent="robot_bridge"), 1, 0, b"\xff\xff")
    recording = [plan(0, 3, (1, 3)), foreign, *(frame(n) for n in range(5)), frame(3), plan(1, 4, (1, 1))]
    assert same(replay(Summing, recording)) == [True, True]
    recording = [frame(0, epoch=1, at=10), frame(0, epoch=2, at=20), plan(0, 10, (1, 0)), plan(1, 30, (2, 0))]
    assert same(replay(Summing, [*recording, plan(0, 20, (2, 0), epoch=10)])) == [True] * 3


def test_another_output_is_different_and_so_is_one_that_is_not_made_again_and_what_lacks_an_input_is_neither():
    other, none = replay(Summing, [frame(3), plan(0, 4, (1, 3)), plan(1, 3, (1, 3))])
    assert not other.same
    assert other.now is not None
    assert decode(GraspPlan, other.now).reason == "3"
    assert (other.key, other.epoch, other.sequence) == (PLAN_KEY, 9, 0)
    assert (none.same, none.now) == (False, None)
    lacking, recording = (Consumed(FRAME_KEY, 1, 3),), [frame(4), plan(0, 3, (1, 3)), plan(1, 4, (1, 4))]
    assert [(r.missing, r.same) for r in replay(Newest, recording)] == [(lacking, False), ((), True)]
    # of an agent that adds up, it costs all that follows
    assert [(r.missing, r.same) for r in replay(Summing, recording)] == [(lacking, False)] * 2


def test_several_outputs_of_one_step_are_compared_in_their_order_and_what_was_not_recorded_is_counted():
    class Twice(Summing):
        def step(self, arrived):
            (output,) = super().step(arrived)
            yield from (output, Output(PLAN, rejection(f"{self.total} again")))

    recording = [frame(3), frame(4), plan(0, 3, (1, 3)), plan(1, "3 again", (1, 3))]
    recording += [plan(2, 7, (1, 4)), plan(3, "7 again", (1, 4))]
    assert same(replay(Twice, recording)) == [True] * 4
    # the recorded agent passed over frame 1, which this one answers
    recording = [*(frame(n) for n in range(5)), plan(0, 2, (1, 1), (1, 2)), plan(1, 4, (1, 4))]
    assert [(r.same, r.unrecorded) for r in replay(Newest, recording)] == [(True, 1), (True, 0)]


class Counting(Agent):
    """Publishes at a goal how many frames it has seen."""

    kind, outputs, commands, inputs, total = "planner", (PLAN,), (GOAL,), (Input(FRAMES),), 0

    def step(self, arrived: Any):
        if isinstance(arrived, Received):
            self.total += 1
            return
        yield accepted(arrived.message.header.id)
        yield Output(PLAN, rejection(f"after {self.total} frames, at {arrived.now_ns}"))


def commanded(topic, received_ns):
    """A recording of a frame, a command, and the plan that followed from both."""
    payload = encode(GraspGoal(new_header("a test"), "psm1", Policy.DIRECT, 0.5, None, None))
    name = key("test", COMMANDS, agent="planner")
    record = CommandRecord(topic, "", payload, received_ns, accepted("id"))
    made = rejection("after 1 frames, at 5000", (Consumed(FRAME_KEY, 1, 0), Consumed(name, 9, 0)))
    return [frame(0), entry(name, 9, 0, encode(record)), entry(PLAN_KEY, 9, 0, encode(made))]


def test_commands_are_replayed_with_the_time_at_which_they_came_and_unknown_ones_are_refused_by_name():
    assert same(replay(Counting, commanded(str(GOAL), 5000))) == [True]
    assert same(replay(Counting, commanded(str(GOAL), 5001))) == [False]
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
            entries.append(entry(name, epoch, sent[output.topic], payload))
            fed.published(name, sent[output.topic])
            sent[output.topic] += 1
    return entries


class Clockwork(Agent):
    """Adds up ticks and frames; tells the sum at every tick, and at every third once more, as an arm does."""

    kind, instance, outputs, tick_hz = "robot_bridge", "psm1", (ROBOT_STATE, EXECUTION), 100.0
    inputs = (Input(FRAMES),)

    def __init__(self):
        self.total, self.ticks = 0, 0

    def step(self, arrived):
        if isinstance(arrived, Received):
            self.total += 100 * arrived.message.stamp.sequence
            return
        self.ticks += 1
        self.total += arrived.now_ns
        pose = np.eye(4)
        yield Output(ROBOT_STATE, RobotState("psm1", self.total, RobotMode.IDLE, pose, np.zeros(6), 0.0, pose, ""))
        if self.ticks % 3 == 0:
            yield Output(EXECUTION, ExecutionEvent("p", "psm1", self.total, ExecutionKind.FINISHED, None, "", ""))


def test_an_agent_that_acts_on_ticks_is_given_the_same_again_until_an_output_of_its_run_is_lost():
    first, second = run_of(Clockwork(), 30), run_of(Clockwork(), 30, epoch=10)
    # what another arm said is left out
    psm2 = [dataclasses.replace(e, key=e.key.replace("psm1", "psm2"), payload=b"\xff") for e in second]
    recording = first + [e for e in psm2 if "psm2" in e.key]
    for seed in range(3):
        random.Random(seed).shuffle(recording)
        assert same(replay(Clockwork, recording)) == [True] * 40
    lost = next(e for e in first if e.key == STATE_KEY and e.sequence == 9)
    replayed = list(replay(Clockwork, [e for e in first if e is not lost] + second))
    after = [r for r in replayed if r.epoch == 9 and not r.same]
    assert (len(replayed), len(after)) == (39 + 40, 20 + 7)
    assert {r.missing for r in after} == {(Consumed(STATE_KEY, 9, 9),)}
    assert all(r.same for r in replayed if r.epoch == 10)


def test_of_two_steps_that_name_the_same_output_before_none_is_left_out():
    before = Consumed(PLAN_KEY, 9, 0)
    made = [rejection(str(total), (before, Consumed(FRAME_KEY, 1, n))) for n, total in ((1, 1), (2, 3))]
    recording = [*(frame(n) for n in range(3)), plan(0, 0, (1, 0))]
    recording += [entry(PLAN_KEY, 9, number, encode(one)) for number, one in enumerate(made, start=1)]
    assert [(r.sequence, r.same) for r in replay(Summing, recording)] == [(0, True), (1, True), (2, True)]


class GoingOn(Summing):
    """Publishes the sum of all frames, and goes on from the sum in its last plan."""

    goes_on_from, inputs = PLAN, (Input(FRAMES, only_newest_counts=True),)

    def step(self, arrived):
        if arrived.topic is PLAN:
            self.total = int(arrived.message.reason)
            return ()
        return super().step(arrived)


class OnesMore(GoingOn):
    """Adds one more at each frame: a changed agent."""

    def step(self, arrived):
        self.total += arrived.topic is FRAMES
        return super().step(arrived)


@pytest.mark.parametrize("lost", [0, 7, 19])
def test_an_agent_that_goes_on_from_its_last_output_is_replayed_from_anywhere_and_a_lost_one_costs_the_next(lost):
    recording = run_of(GoingOn(), 20)
    for kept in (recording[2 * lost + 2 :], [e for e in recording if (e.key, e.sequence) != (PLAN_KEY, lost)]):
        replayed = list(replay(GoingOn, kept))
        numbers = [e.sequence for e in kept if e.key == PLAN_KEY]
        assert [(r.sequence, r.same) for r in replayed] == [(number, number != lost + 1) for number in numbers]
        assert {r.missing for r in replayed if not r.same} <= {(Consumed(PLAN_KEY, 9, lost),)}


def test_a_changed_agent_goes_on_from_the_recorded_state_or_from_its_own_where_it_has_one():
    def reasons(recording, **how):
        return [r.now and int(decode(GraspPlan, r.now).reason) for r in replay(OnesMore, recording, **how)]

    recording = run_of(GoingOn(), 6)
    sums = [0, 1, 3, 6, 10, 15]
    assert reasons(recording) == [s + 1 for s in sums]
    assert reasons(recording, from_own_state=True) == [s + n + 1 for n, s in enumerate(sums)]
    assert all(same(replay(GoingOn, recording, from_own_state=True)))
    # after an output that cannot be repeated it goes on from the recorded one
    lacking = [e for e in recording if (e.key, e.sequence) != (FRAME_KEY, 2)]
    assert reasons(lacking, from_own_state=True) == [0 + 1, 1 + 2, None, 6 + 1, 10 + 2, 15 + 3]


def test_a_step_that_failed_live_fails_again_and_what_follows_is_the_same():
    class Failing(Summing):
        def step(self, arrived):
            if arrived.message.stamp.sequence % 2:
                self.total += 7
                raise ZeroDivisionError("an odd frame")
            return super().step(arrived)

    assert same(replay(Failing, [frame(1), frame(2), plan(0, 9, (1, 1), (1, 2))])) == [True]


EPOCH, OWN_TICK = 7, f"suturegrasp/test/planner/main/{TICK}"


class Some(Idle):
    outputs = (PLAN,)

    def __init__(self, only_newest_counts=False, **how):
        self.inputs = (Input(FRAMES, only_newest_counts=only_newest_counts),)
        vars(self).update(how)


def fed(**how):
    return Fed(Some(**how), "test", EPOCH)


def test_a_list_holds_messages_and_ticks_in_their_order_and_the_next_begins_with_the_output_before():
    each = fed(tick_hz=10.0)
    each.tick(1000)
    each.message(FRAME_KEY, 3, 5)
    each.tick(2000)
    ticks = Consumed(OWN_TICK, EPOCH, 1000), Consumed(OWN_TICK, EPOCH, 2000)
    assert each.listed() == (ticks[0], Consumed(FRAME_KEY, 3, 5), ticks[1])
    each.published(PLAN_KEY, 4)
    each.tick(2000)
    assert each.listed() == (Consumed(PLAN_KEY, EPOCH, 4), ticks[1])
    # nothing is published where ticks are listed
    assert is_tick(OWN_TICK)
    assert {TICK, OMITTED}.isdisjoint(topic.name for topic in TOPICS)


def test_a_list_does_not_grow_without_bound_and_says_how_much_it_leaves_out_or_lists_the_newest_idle_tick_alone():
    each, idle = fed(tick_hz=10.0), fed(tick_hz=10.0, only_newest_tick_counts=True)
    each.message(STATE_KEY, 1, 1, only_newest_counts=True)
    for at_ns in range(MOST_LISTED + 9):
        each.tick(at_ns)
        idle.tick(at_ns)
    assert idle.listed() == (Consumed(OWN_TICK, EPOCH, MOST_LISTED + 8),)
    left_out, state = Consumed(f"suturegrasp/test/planner/main/{OMITTED}", EPOCH, 10), Consumed(STATE_KEY, 1, 1)
    assert each.listed()[:2] == (left_out, state)
    assert [c.sequence for c in each.listed()[2:]] == list(range(10, MOST_LISTED + 9))
    each.published(PLAN_KEY, 0)
    assert each.listed() == (state, Consumed(PLAN_KEY, EPOCH, 0))
