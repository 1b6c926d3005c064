"""Bytes of one topic under the key of another, by real sessions: nothing is delivered, it is counted, and said."""

import contextlib
import logging

import pytest
import zenoh

from schemas.codec import decode, encode, encoding_name
from schemas.messages import (
    AgentFacts,
    AgentHealth,
    ClockReading,
    CommandAnswer,
    Heartbeat,
    Hold,
    LogRecord,
    Outcome,
    Progress,
)
from schemas.topics import FRAMES, HEALTH, HEARTBEAT, HOLD, LOG, PLAN, key
from shared.runtime.agent import Command, Input, Received
from shared.runtime.attachment import Attachment, pack
from shared.runtime.clocks import clock_offset
from shared.runtime.commands import accepted, new_header, send_command
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher, subscribe
from shared.runtime.facts import FACTS, ask_facts
from shared.runtime.lossless import is_of
from shared.runtime.own_key import encoding_of, other_key
from shared.runtime.progress import PROGRESS, ask_progress
from shared.runtime.session import open_session
from shared.runtime.taps import tap

OTHER = "suturegrasp/test/planner/other/plan"


@pytest.fixture
def listening(settings):
    """Have what comes of a topic, and what was refused of it, as lists, in a session of its own."""
    with contextlib.ExitStack() as stack:

        def listen(topic):
            came, missed, refused = [], [], []
            receiver = stack.enter_context(open_session(settings))
            ways = came.append, missed.append, None, lambda *both: refused.append(both)
            for declared in subscribe(receiver, key("test", topic), topic, *ways):
                stack.callback(declared.undeclare)
            return came, missed, refused

        yield listen


def test_a_message_names_the_key_that_it_was_sent_under():
    own = key("test", PLAN)
    assert encoding_of(PLAN.message, own).startswith(encoding_name(PLAN.message))
    assert other_key(zenoh.Encoding(encoding_of(PLAN.message, own)), own) == ""
    assert other_key(zenoh.Encoding(encoding_of(PLAN.message, own)), OTHER) == own


def test_one_that_names_no_key_comes_from_an_earlier_version_and_is_taken():
    assert other_key(zenoh.Encoding(encoding_name(PLAN.message)), OTHER) == ""
    assert other_key(None, OTHER) == ""


@pytest.mark.parametrize("topic", [FRAMES, PLAN], ids=str)
def test_only_what_names_the_key_that_it_came_under_is_handed_over(topic, listening, session, heard_by_others, until):
    came, missed, refused = listening(topic)
    own = key("test", topic)
    heard_by_others(session, own)
    publisher = declare_publisher(session, own, topic)
    publisher.put(b"first", attachment=pack(Attachment(1, 0, 0, 0.0)))
    session.put(own, b"foreign", encoding=encoding_of(topic.message, OTHER))
    publisher.put(b"last", attachment=pack(Attachment(1, 1, 0, 0.0)))
    until(lambda: len(came) == 2 and refused)
    assert [sample.payload.to_bytes() for sample in came] == [b"first", b"last"]
    assert (missed, refused) == ([], [(own, OTHER)])
    publisher.undeclare()


def test_a_foreign_number_keeps_no_event_back(listening, session, heard_by_others, until):
    came, missed, refused = listening(PLAN)
    own = key("test", PLAN)
    heard_by_others(session, own)
    publisher = declare_publisher(session, own, PLAN)
    publisher.put(b"0")
    of = until(lambda: came)[0].source_info.source_id
    foreign = zenoh.SourceInfo(of, 400)
    session.put(own, b"foreign", encoding=encoding_of(PLAN.message, OTHER), source_info=foreign)
    until(lambda: refused)
    for number in range(1, 4):
        publisher.put(str(number).encode())
    until(lambda: len(came) == 4)
    assert missed == []
    publisher.undeclare()


def test_what_a_cache_gives_of_another_key_or_publisher_is_taken_for_no_event(session, until):
    heard, own = [], key("test", PLAN)
    with session.declare_subscriber("suturegrasp/test/planner/*/plan", heard.append):
        publisher = declare_publisher(session, own, PLAN)
        publisher.put(b"numbered")
        of = until(lambda: heard)[0].source_info.source_id
        place, number = (own, str(of.zid), of.eid), zenoh.SourceInfo(of, 1)
        session.put(own, b"of an earlier version", source_info=number)
        session.put(own, b"names another", encoding=encoding_of(PLAN.message, OTHER), source_info=number)
        session.put(OTHER, b"has another key", source_info=number)
        session.put(own, b"is unnumbered")
        until(lambda: len(heard) == 5)
        assert [sample.payload.to_string() for sample in heard if is_of(place, sample)] == [
            "numbered",
            "of an earlier version",
        ]
        assert not any(is_of((own, str(of.zid), of.eid + 1), sample) for sample in heard)
        publisher.undeclare()


def test_nobody_who_only_listens_is_handed_what_names_another_key(session, settings, heard_by_others, until, caplog):
    heard = []
    with open_session(settings) as receiver:
        kept = tap(receiver, "test", (PLAN,), heard.append, lambda *_: None)
        heard_by_others(session, key("test", PLAN))
        session.put(key("test", PLAN), b"foreign", encoding=encoding_of(PLAN.message, OTHER))
        session.put(key("test", PLAN), b"of an earlier version")
        until(lambda: heard)
        for declared in kept:
            declared.undeclare()
    assert [tapped.payload for tapped in heard] == [b"of an earlier version"]
    assert f"was sent under {OTHER}" in caplog.text


class Bridge:
    """Hears plans, and holds where it is told to."""

    kind, instance, outputs, commands, tick_hz = "robot_bridge", "psm1", (), (HOLD,), None
    inputs = (Input(PLAN),)

    def __init__(self):
        self.steps = []

    def step(self, arrived):
        self.steps.append(arrived)
        return (accepted(arrived.message.header.id),) if isinstance(arrived, Command) else ()


def told(session, topic, message_type):
    heard = []
    kept = tap(session, "test", (topic,), lambda t: heard.append(decode(message_type, t.payload)), lambda *_: None)
    return heard, kept


def test_an_agent_counts_what_names_another_key_as_refused_and_says_whose_it_is(running, session, until):
    healths, kept = told(session, HEALTH, AgentHealth)
    log, more = told(session, LOG, LogRecord)
    bridge = Bridge()
    running(bridge)
    until(lambda: healths)
    foreign = encoding_of(PLAN.message, OTHER)
    until(lambda: session.put(key("test", PLAN), b"foreign", encoding=foreign) or healths[-1].inputs[0].refused)
    assert bridge.steps == []
    assert (healths[-1].inputs[0].received, healths[-1].inputs[0].missed) == (0, 0)
    until(lambda: any(f"it was sent under {OTHER}" in record.text for record in log))
    for declared in (*kept, *more):
        declared.undeclare()


def test_who_only_listens_counts_what_names_another_key_in_its_health(settings, session, until):
    healths, kept = told(session, HEALTH, AgentHealth)
    own, foreign, came = key("test", PLAN), encoding_of(PLAN.message, OTHER), []
    with connected(settings, 60.0) as connection:
        # two that listen to one topic refuse one message twice
        connection.listen((PLAN, LOG), came.append)
        connection.listen((PLAN,), lambda _: None)
        with connection.reporting("viewer", "main", logging.getLogger("suturegrasp.test"), str):
            assert until(lambda: healths)[-1].inputs == ()
            publisher = declare_publisher(session, own, PLAN)
            until(lambda: publisher.put(b"its own", attachment=pack(Attachment(1, 0, 0, 0.0))) or came)
            session.put(own, b"foreign", encoding=foreign)
            (heard,) = until(lambda: healths[-1].inputs, "a refusal to be told")
            publisher.undeclare()
    assert (heard.topic, heard.refused, heard.received >= 1) == ("planner/plan", 1, True)
    assert b"foreign" not in [tapped.payload for tapped in came]
    for declared in kept:
        declared.undeclare()


def test_what_speaks_of_another_arm_than_its_key_is_refused_by_who_hears_it(running, session, until):
    healths, kept = told(session, HEALTH, AgentHealth)
    bridge = Bridge()
    bridge.inputs = (Input(HEARTBEAT, "psm1"),)
    running(bridge)
    until(lambda: healths)
    own = key("test", HEARTBEAT, "psm1")

    def beat(arm, sequence):
        message = encode(Heartbeat(arm, "plan", 1, "arming"))
        session.put(
            own, message, encoding=encoding_of(Heartbeat, own), attachment=pack(Attachment(1, sequence, 1, 0.0))
        )

    until(lambda: beat("psm2", 0) or healths[-1].inputs[0].refused)
    assert bridge.steps == []
    until(lambda: beat("psm1", 1) or bridge.steps)
    for declared in kept:
        declared.undeclare()


def test_a_command_for_another_arm_is_not_carried_out_and_its_sender_is_told_why(running, session, until):
    bridge = Bridge()
    running(bridge)
    hold = Hold(new_header("a test"), "psm1")
    until(lambda: send_command(session, "test", HOLD, hold, "psm1").outcome is Outcome.ACCEPTED)
    other = Hold(new_header("a test"), "psm1")
    meant = key("test", HOLD, "psm2")
    (reply,) = session.get(
        key("test", HOLD, "psm1"), payload=encode(other), encoding=encoding_of(HOLD.message, meant), timeout=20.0
    )
    answer = decode(CommandAnswer, reply.ok.payload.to_bytes())
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "other_key")
    assert meant in answer.reason
    assert [step.message.header.id for step in bridge.steps if not isinstance(step, Received)] == [hold.header.id]


@pytest.mark.parametrize("of", ["another command", ""], ids=["another", "none"])
def test_the_answer_to_another_command_is_no_answer(session, settings, of):
    with open_session(settings) as receiver:
        own = key("test", HOLD, "psm1")

        def answer(query):
            query.reply(own, encode(accepted(of)))

        kept = receiver.declare_queryable(own, answer, complete=True)
        command = Hold(new_header("a test"), "psm1")
        told = send_command(session, "test", HOLD, command, "psm1", timeout_s=2.0)
        kept.undeclare()
    assert (told.id, told.outcome) == (command.header.id, Outcome.UNKNOWN)


def test_a_clock_that_names_another_key_is_not_compared(session, settings, until):
    own = "suturegrasp/test/camera/main/clock"
    reading, names, answered = encode(ClockReading("box", 0)), [own], []

    def answer(query):
        query.reply(own, reading, encoding=encoding_of(ClockReading, names[0]))
        answered.append(names[0])

    def offset():
        return clock_offset(session, "test", "camera", "main", trips=1)

    with open_session(settings) as receiver, receiver.declare_queryable(own, answer):
        assert until(offset).host == "box"
        names[0] = OTHER
        assert offset() is None
        assert OTHER in answered


FACTS_TOLD = AgentFacts(
    "camera", "main", "box", 1, "0.1", "a", "b", "3.11", "1.10", False, "", None, None, "", "", None, None, None, 0.0, 0
)


@pytest.mark.parametrize(
    ("last_part", "told", "ask"),
    [(FACTS, FACTS_TOLD, ask_facts), (PROGRESS, Progress("none", (), ()), ask_progress)],
    ids=["facts", "progress"],
)
def test_an_answer_that_names_another_key_is_nobodys(last_part, told, ask, session, settings, until):
    own = f"suturegrasp/test/camera/main/{last_part}"
    names, answered = [own], []

    def answer(query):
        query.reply(own, encode(told), encoding=encoding_of(type(told), names[0]))
        answered.append(names[0])

    with open_session(settings) as receiver, receiver.declare_queryable(own, answer):
        until(lambda: ask(session, "test") == {"camera/main": told})
        names[0] = OTHER
        assert ask(session, "test") == {}
        assert OTHER in answered
