"""Commands that stop, on real sessions: nothing in the runtime holds them up, whatever fails beside them."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from schemas.codec import decode, encode
from schemas.messages import Arm, ChangeState, CommandAnswer, CommandHeader, Hold, Outcome, StateWord
from schemas.topics import ARM, CHANGE_STATE, HOLD, key
from shared.clock import monotonic_s
from shared.runtime.agent import Agent, Command
from shared.runtime.attachment import encoding_of
from shared.runtime.commands import accepted, new_header, refused, send_command, stops_unread
from shared.runtime.outlets import Outlets

STEP_S, HOLD_KEY = 0.5, key("test", HOLD, "psm1")


class Robot(Agent):
    """An agent whose arming takes long, and which notes when it was halted and what it was told to do."""

    kind, instance, commands, tick_hz = "robot_bridge", "psm1", (ARM, HOLD, CHANGE_STATE), 50.0

    def __init__(self):
        self.halted_s, self.stepped, self.arming, self.ticks = [], [], threading.Event(), 0

    def halt(self):
        self.halted_s.append(monotonic_s())

    def step(self, arrived):
        if not isinstance(arrived, Command):
            self.ticks += 1
            return []
        if isinstance(arrived.message, Arm):
            self.arming.set()
            threading.Event().wait(STEP_S)
        self.stepped.append(type(arrived.message))
        return [accepted(arrived.message.header.id)]


@pytest.fixture
def robot(running, session, until):
    made = Robot()
    running(made)
    # it is there, and is found
    until(lambda: made.ticks > 5 and hold(session).outcome is Outcome.ACCEPTED)
    made.halted_s.clear()
    made.stepped.clear()
    return made


def sent(session, topic, message, arm="psm1"):
    return send_command(session, "test", topic, message, arm, timeout_s=20.0)


def hold(session):
    return sent(session, HOLD, Hold(new_header("a test"), "psm1"))


def test_an_arm_is_halted_while_a_step_still_goes_on_and_the_hold_is_stepped_before_what_came_earlier(robot, session):
    with ThreadPoolExecutor(4) as asking:
        arms = [Arm(new_header("a test"), "psm1", f"plan-{number}") for number in range(3)]
        others = [asking.submit(sent, session, ARM, arm) for arm in arms]
        assert robot.arming.wait(20.0)
        asked_s = monotonic_s()
        assert hold(session).outcome is Outcome.ACCEPTED
        assert robot.halted_s[0] - asked_s < STEP_S / 2, "it waited for no step"
        assert robot.stepped.index(Hold) <= 1, "of three armings, one at most was ahead of it"
        assert all(other.result().outcome is Outcome.ACCEPTED for other in others)


@pytest.mark.parametrize("word", [StateWord.PAUSE, StateWord.DISABLE])
def test_pausing_and_disabling_are_carried_out_whatever_their_deadline_and_halt_the_arm_at_once(robot, session, word):
    answer = sent(session, CHANGE_STATE, ChangeState(CommandHeader("late", 1, "a test"), "psm1", word))
    assert (answer.outcome, robot.stepped, len(robot.halted_s)) == (Outcome.ACCEPTED, [ChangeState], 1)
    late_too = ChangeState(CommandHeader("late too", 1, "a test"), "psm1", StateWord.RESUME)
    assert sent(session, CHANGE_STATE, late_too).code == "late"


@pytest.mark.parametrize("deadline_ns", [1, 2**62])
def test_a_hold_is_carried_out_again_whatever_its_deadline_and_even_where_its_id_was_used(robot, session, deadline_ns):
    message = Hold(CommandHeader("one id", deadline_ns, "a test"), "psm1")
    for count in (1, 2):
        assert sent(session, HOLD, message).outcome is Outcome.ACCEPTED
        assert (robot.stepped, len(robot.halted_s)) == ([Hold] * count, count)


def test_what_came_to_the_key_of_holds_and_cannot_be_read_halts_the_arm(robot, session):
    replies = list(session.get(HOLD_KEY, payload=b"\xff\xff", timeout=20.0))
    assert (len(replies), len(robot.halted_s)) == (1, 1)
    assert stops_unread(HOLD, b"")
    assert not stops_unread(ARM, encode(Arm(new_header("a test"), "psm1", "p")))
    assert stops_unread(CHANGE_STATE, b"\xff\xff"), "it may be of a newer version, and mean to"


def test_an_arm_is_disabled_however_many_holds_wait_before_that(robot, session):
    with ThreadPoolExecutor(16) as asking:
        asking.submit(sent, session, ARM, Arm(new_header("a test"), "psm1", "plan"))
        assert robot.arming.wait(20.0)
        holds = [asking.submit(hold, session) for _ in range(12)]
        disables = ChangeState(new_header("a test"), "psm1", StateWord.DISABLE)
        answer = asking.submit(sent, session, CHANGE_STATE, disables).result()
        assert {each.result().outcome for each in holds} == {Outcome.ACCEPTED}
    assert (answer.outcome, ChangeState in robot.stepped) == (Outcome.ACCEPTED, True)


def test_a_flood_of_holds_is_answered_and_keeps_no_tick_away(robot, session):
    before, began_s = robot.ticks, monotonic_s()
    with ThreadPoolExecutor(16) as asking:
        answers = list(asking.map(lambda _: hold(session), range(600)))
    took_s = monotonic_s() - began_s
    assert {answer.outcome for answer in answers} == {Outcome.ACCEPTED}
    assert len(robot.halted_s) == 600
    assert robot.ticks - before > 0.4 * took_s * robot.tick_hz


def test_a_hold_is_carried_out_and_answered_where_nothing_can_be_published(robot, session, monkeypatch):
    def fails(*_args, **_rest):
        raise OSError("the session is gone")

    monkeypatch.setattr(Outlets, "publish", fails)
    assert hold(session).outcome is Outcome.ACCEPTED
    assert (robot.stepped, len(robot.halted_s)) == ([Hold], 1)
    assert hold(session).outcome is Outcome.ACCEPTED, "the loop goes on"
    monkeypatch.undo()


def test_a_hold_that_came_under_another_arms_key_halts_this_one_too_and_is_told_again(robot, session):
    message, foreign = encode(Hold(new_header("a test"), "psm2")), encoding_of(Hold, key("test", HOLD, "psm2"))
    (reply,) = session.get(HOLD_KEY, payload=message, encoding=foreign, timeout=20.0)
    answer = decode(CommandAnswer, reply.ok.payload.to_bytes())
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "other_key")
    assert (len(robot.halted_s), robot.stepped) == (1, [])


def test_what_came_to_another_receiver_is_sent_again(session, keep):
    asked, message = [], Hold(new_header("a test"), "psm3")

    def answer(query):
        asked.append(query.payload.to_bytes())
        reply = refused("", "other_key", "not ours") if len(asked) == 1 else accepted(message.header.id)
        query.reply(query.key_expr, encode(reply))
        query.drop()

    keep(session.declare_queryable(key("test", HOLD, "psm3"), answer))
    assert sent(session, HOLD, message, "psm3").outcome is Outcome.ACCEPTED
    assert asked == [encode(message)] * 2
