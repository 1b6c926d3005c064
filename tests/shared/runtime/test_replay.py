"""Replay against small agents whose every rule is known."""

import contextlib
import dataclasses
import random
from dataclasses import dataclass

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
    Outcome,
    Policy,
    RobotMode,
    RobotState,
    Status,
    StereoFrame,
)
from schemas.topics import COMMANDS, EXECUTION, FRAMES, GOAL, PLAN, ROBOT_STATE, key
from shared.runtime.agent import Input, Output, Received, Tick
from shared.runtime.commands import accepted, new_header, send_command
from shared.runtime.fed import Fed
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


class Newest(Summing):
    """Publishes the number of each frame, whatever came before."""

    inputs = (Input(FRAMES, only_newest_counts=True),)

    def step(self, arrived):
        self.total = 0
        return super().step(arrived)


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
    recording = [frame(4), plan(0, "3 number 0", (1, 3)), plan(1, "4 number 0", (1, 4))]
    missing, later = replay(Newest, recording)
    assert missing.missing == (Consumed(FRAME_KEY, 1, 3),)
    assert missing.now is None
    assert later.same


def test_of_an_agent_that_adds_up_nothing_is_known_from_what_is_missing_on():
    recording = [frame(4), plan(0, "3 number 0", (1, 3)), plan(1, "7 number 0", (1, 4))]
    assert [r.missing for r in replay(Summing, recording)] == [(Consumed(FRAME_KEY, 1, 3),)] * 2
    assert not any(r.same for r in replay(Summing, recording))


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
        return GraspGoal(new_header("a test", 60.0), "psm1", Policy.DIRECT, 0.5, None, None)

    for _ in range(3):
        sent = goal()
        until(lambda sent=sent: send_command(session, "test", GOAL, sent).outcome is Outcome.ACCEPTED)
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


class Clockwork:
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


def run_of(agent, frames, epoch=9):
    """What a run of an agent would leave in a recording: between two ticks one frame."""
    fed, sent, entries = Fed(agent, "test", epoch), dict.fromkeys(agent.outputs, 0), []
    last = frame(0)
    for number in range(frames):
        made = frame(number)
        entries.append(made)
        fed.message(made.key, made.epoch, made.sequence)
        list(agent.step(Received(FRAMES, made.key, made.sequence, decode(StereoFrame, made.payload))))
        fed.tick(1000 + number)
        listed = fed.listed()
        for output in agent.step(Tick(1000 + number)):
            payload = encode(dataclasses.replace(output.message, consumed=listed))
            entries.append(Entry(key("test", output.topic, "psm1"), epoch, sent[output.topic], payload))
            last = entries[-1]
            sent[output.topic] += 1
        fed.published(last.key, last.sequence)
    return entries


def test_an_agent_that_acts_on_ticks_is_given_the_same_ticks_again():
    recording = run_of(Clockwork(), 30)
    replayed = list(replay(Clockwork, recording))
    assert len(replayed) == 40
    assert all(r.same for r in replayed)


def test_a_tick_at_another_time_shows():
    recording = run_of(Clockwork(), 30)

    class Late(Clockwork):
        def step(self, arrived):
            return super().step(Tick(arrived.now_ns + 1) if isinstance(arrived, Tick) else arrived)

    assert not any(r.same or r.missing for r in replay(Late, recording))


@pytest.mark.parametrize("seed", range(5))
def test_the_order_in_which_several_outputs_were_recorded_decides_nothing(seed):
    recording = run_of(Clockwork(), 30)
    random.Random(seed).shuffle(recording)
    assert [r.same for r in replay(Clockwork, recording)] == [True] * 40


def test_of_two_steps_that_name_the_same_output_before_none_is_left_out():
    before = Consumed(PLAN_KEY, 9, 0)
    first, *others = (plan(n, f"{total} number 0", (1, n)) for n, total in enumerate((0, 1, 3)))
    others = [dataclasses.replace(o, payload=also_consumed(o.payload, before)) for o in others]
    replayed = list(replay(Summing, [*(frame(n) for n in range(3)), first, *others]))
    assert [r.sequence for r in replayed] == [0, 1, 2]
    assert all(r.same for r in replayed)


def also_consumed(payload, *consumed):
    recorded = decode(GraspPlan, payload)
    return encode(dataclasses.replace(recorded, consumed=(*consumed, *recorded.consumed)))


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


def state_run(agent, frames, epoch=9):
    """What a run of an agent that answers each frame leaves in a recording."""
    fed, entries = Fed(agent, "test", epoch), []
    for number in range(frames):
        made = frame(number)
        fed.message(made.key, made.epoch, made.sequence, only_newest_counts=True)
        (output,) = agent.step(Received(FRAMES, made.key, made.sequence, decode(StereoFrame, made.payload)))
        payload = encode(dataclasses.replace(output.message, consumed=fed.listed()))
        entries += [made, Entry(PLAN_KEY, epoch, number, payload)]
        fed.published(PLAN_KEY, number)
    return entries


@pytest.mark.parametrize("begin", range(0, 20, 3))
def test_an_agent_that_goes_on_from_its_last_output_is_replayed_from_anywhere(begin):
    recording = state_run(GoingOn(), 20)[2 * begin :]
    replayed = list(replay(GoingOn, recording))
    assert [r.sequence for r in replayed] == list(range(begin, 20))
    if begin:
        lost = replayed.pop(0)
        assert (lost.now, lost.missing) == (None, (Consumed(PLAN_KEY, 9, begin - 1),))
    assert all(r.same and not r.missing for r in replayed)


def test_of_an_agent_that_goes_on_from_its_last_output_a_lost_one_costs_the_next_alone():
    recording = [e for e in state_run(GoingOn(), 20) if (e.key, e.sequence) != (PLAN_KEY, 7)]
    replayed = {r.sequence: r for r in replay(GoingOn, recording)}
    assert replayed[8].missing == (Consumed(PLAN_KEY, 9, 7),)
    assert [n for n, r in replayed.items() if not r.same] == [8]


def test_what_an_agent_keeps_beside_the_output_that_it_goes_on_from_shows():
    class Secretive(GoingOn):
        """Counts its steps for itself."""

        def __init__(self):
            super().__init__()
            self.steps = 0

        def step(self, arrived):
            self.steps += arrived.topic is FRAMES
            for output in super().step(arrived):
                yield Output(PLAN, dataclasses.replace(output.message, plan_id=f"{self.steps}"))

    whole = state_run(Secretive(), 12)
    assert all(r.same for r in replay(Secretive, whole))
    assert not any(r.same for r in replay(Secretive, whole[8:]))


class OnesMore(GoingOn):
    """Adds one more at each frame: a changed agent."""

    def step(self, arrived):
        self.total += arrived.topic is FRAMES
        yield from super().step(arrived)


def reasons(replayed):
    return [int(decode(GraspPlan, r.now).reason) for r in replayed]


def test_a_changed_agent_goes_on_from_the_recorded_state_or_from_its_own():
    recording = state_run(GoingOn(), 6)
    sums = [0, 1, 3, 6, 10, 15]
    assert reasons(replay(OnesMore, recording)) == [s + 1 for s in sums]
    assert reasons(replay(OnesMore, recording, from_own_state=True)) == [s + n + 1 for n, s in enumerate(sums)]
    assert all(r.same for r in replay(GoingOn, recording, from_own_state=True))


@pytest.mark.parametrize("lost", range(5))
def test_after_an_output_that_cannot_be_repeated_it_goes_on_from_the_recorded_one(lost):
    recording = [e for e in state_run(GoingOn(), 8) if (e.key, e.sequence) != (FRAME_KEY, lost)]
    replayed = {r.sequence: r for r in replay(OnesMore, recording, from_own_state=True)}
    assert [n for n, r in replayed.items() if r.missing] == [lost]
    after = [replayed[n] for n in range(lost + 1, 8)]
    assert [decode(GraspPlan, r.then).reason for r in after] == [
        str(total - more - 1) for more, total in enumerate(reasons(after))
    ]


def test_what_an_agent_makes_beyond_what_was_recorded_is_counted_and_taken_for_nothing_else():
    # the recorded agent passed over frame 1, which this one answers
    recording = [frame(n) for n in range(5)] + [plan(0, "2 number 0", (1, 1), (1, 2)), plan(1, "4 number 0", (1, 4))]
    first, second = replay(Newest, recording)
    assert first.same
    assert second.same
    assert (first.unrecorded, second.unrecorded) == (1, 0)


def test_of_two_arms_in_a_recording_the_other_one_is_left_out():
    recording = run_of(Clockwork(), 3)
    other = [Entry(e.key.replace("psm1", "psm2"), e.epoch, e.sequence, b"\xff") for e in recording if "psm1" in e.key]
    assert [r.same for r in replay(Clockwork, other + recording)] == [True] * 4


def test_a_step_that_failed_live_fails_again_and_what_follows_is_the_same():
    class Failing(Clockwork):
        def step(self, arrived):
            if isinstance(arrived, Received) and arrived.message.stamp.sequence % 2:
                self.total += 7
                raise ZeroDivisionError("an odd frame")
            return super().step(arrived)

    recording = []
    fed, agent = Fed(Failing(), "test", 9), Failing()
    for number in range(4):
        recording.append(frame(number))
        fed.message(FRAME_KEY, 1, number)
        with contextlib.suppress(ZeroDivisionError):
            list(agent.step(Received(FRAMES, FRAME_KEY, number, decode(StereoFrame, recording[-1].payload))))
    fed.tick(1000)
    (output,) = agent.step(Tick(1000))
    payload = encode(dataclasses.replace(output.message, consumed=fed.listed()))
    recording.append(Entry(key("test", ROBOT_STATE, "psm1"), 9, 0, payload))
    assert [r.same for r in replay(Failing, recording)] == [True]
