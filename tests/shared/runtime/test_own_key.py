"""Bytes of one topic under the key of another, by real sessions: nothing is delivered, it is counted, and said."""

import contextlib
import logging
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from schemas.codec import encode, encoding_name
from schemas.messages import (
    AgentFacts,
    AgentHealth,
    ClockReading,
    Heartbeat,
    Hold,
    LogRecord,
    Outcome,
    Progress,
)
from schemas.topics import FRAMES, HEALTH, HEARTBEAT, HOLD, LOG, PLAN, key
from shared.runtime.agent import Agent, Input
from shared.runtime.attachment import Attachment, encoding_of, other_key, pack
from shared.runtime.clocks import CLOCK, clock_offset
from shared.runtime.commands import accepted, new_header, send_command
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher, subscribe
from shared.runtime.facts import FACTS, ask_facts
from shared.runtime.lossless import is_of
from shared.runtime.progress import PROGRESS, ask_progress
from shared.runtime.session import open_session

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


def test_a_message_names_the_key_that_it_was_sent_under_or_comes_from_an_earlier_version_and_is_taken():
    own = key("test", PLAN)
    named = zenoh.Encoding(encoding_of(PLAN.message, own))
    assert str(named).startswith(encoding_name(PLAN.message))
    assert (other_key(named, own), other_key(named, OTHER)) == ("", own)
    assert other_key(zenoh.Encoding(encoding_name(PLAN.message)), OTHER) == ""
    assert other_key(None, OTHER) == ""


@pytest.mark.parametrize("topic", [FRAMES, PLAN], ids=str)
def test_what_names_another_key_is_not_handed_over_and_its_number_keeps_nothing_back(
    topic, listening, session, heard_by_others, until
):
    came, missed, refused = listening(topic)
    own = key("test", topic)
    heard_by_others(session, own)
    publisher = declare_publisher(session, own, topic)
    publisher.put(b"first", attachment=pack(Attachment(1, 0, 0, 0.0)))
    numbered = until(lambda: came)[0].source_info
    foreign = zenoh.SourceInfo(numbered.source_id, 400) if numbered is not None else None
    session.put(own, b"foreign", encoding=encoding_of(topic.message, OTHER), source_info=foreign)
    until(lambda: refused)
    publisher.put(b"last", attachment=pack(Attachment(1, 1, 0, 0.0)))
    until(lambda: len(came) == 2)
    assert [sample.payload.to_bytes() for sample in came] == [b"first", b"last"]
    assert (missed, refused) == ([], [(own, OTHER)])
    publisher.undeclare()


def test_what_a_cache_gives_of_another_key_or_publisher_is_taken_for_no_event():
    own, place = key("test", PLAN), SimpleNamespace(source_id=SimpleNamespace(zid="abc", eid=3))

    def given(under=own, names=own, numbered=True) -> Any:
        encoding = zenoh.Encoding(encoding_of(PLAN.message, names))
        return SimpleNamespace(key_expr=under, encoding=encoding, source_info=place if numbered else None)

    assert is_of((own, "abc", 3), given())
    for other in (given(under=OTHER, names=OTHER), given(names=OTHER), given(numbered=False)):
        assert not is_of((own, "abc", 3), other)
    assert not is_of((own, "abc", 4), given())


@pytest.fixture(autouse=True)
def health_comes_often(monkeypatch):
    monkeypatch.setattr("shared.runtime.runner.HEALTH_PERIOD_S", 0.05)
    monkeypatch.setattr("shared.runtime.taps.PERIOD_S", 0.05)


class Bridge(Agent):
    """Hears plans."""

    kind, instance, outputs, commands, tick_hz = "robot_bridge", "psm1", (), (), None
    inputs = (Input(PLAN),)

    def __init__(self):
        self.steps = []

    def step(self, arrived):
        self.steps.append(arrived)
        return ()


def test_an_agent_counts_what_names_another_key_as_refused_and_says_whose_it_is(running, session, heard, until):
    healths: list[AgentHealth] = heard(HEALTH)
    log: list[LogRecord] = heard(LOG)
    bridge = Bridge()
    running(bridge)
    until(lambda: healths)
    foreign = encoding_of(PLAN.message, OTHER)
    until(lambda: session.put(key("test", PLAN), b"foreign", encoding=foreign) or healths[-1].inputs[0].refused)
    assert bridge.steps == []
    assert (healths[-1].inputs[0].received, healths[-1].inputs[0].missed) == (0, 0)
    until(lambda: any(f"it was sent under {OTHER}" in record.text for record in log))


def test_who_only_listens_counts_what_names_another_key_in_its_health(settings, session, heard, until):
    healths: list[AgentHealth] = heard(HEALTH)
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
            (told,) = until(lambda: healths[-1].inputs, "a refusal to be told")
            publisher.undeclare()
    assert (told.topic, told.refused, told.received >= 1) == ("planner/plan", 1, True)
    assert b"foreign" not in [tapped.payload for tapped in came]


def test_what_speaks_of_another_arm_than_its_key_is_refused_by_who_hears_it(running, session, heard, until):
    healths: list[AgentHealth] = heard(HEALTH)
    bridge = Bridge()
    bridge.inputs = (Input(HEARTBEAT, "psm1"),)
    running(bridge)
    until(lambda: healths)
    own = key("test", HEARTBEAT, "psm1")

    def beat(arm, sequence):
        beside = pack(Attachment(1, sequence, 1, 0.0))
        message = encode(Heartbeat(arm, "plan", 1, "arming"))
        session.put(own, message, encoding=encoding_of(Heartbeat, own), attachment=beside)

    until(lambda: beat("psm2", 0) or healths[-1].inputs[0].refused)
    assert bridge.steps == []
    until(lambda: beat("psm1", 1) or bridge.steps)


@pytest.mark.parametrize("of", ["another command", ""], ids=["another", "none"])
def test_the_answer_to_another_command_is_no_answer(session, settings, of):
    command = Hold(new_header("a test"), "psm1")
    own = key("test", HOLD, "psm1")
    with open_session(settings) as receiver:
        kept = receiver.declare_queryable(own, lambda query: query.reply(own, encode(accepted(of))), complete=True)
        told = send_command(session, "test", HOLD, command, "psm1", timeout_s=1.0)
        kept.undeclare()
    assert (told.id, told.outcome) == (command.header.id, Outcome.UNKNOWN)


FACTS_TOLD = AgentFacts(
    "camera", "main", "box", 1, "0.1", "a", "b", "3.11", "1.10", False, "", None, None, "", "", None, None, None, 0.0, 0
)


@pytest.mark.parametrize(
    ("last_part", "told", "ask"),
    [
        (FACTS, FACTS_TOLD, lambda session: ask_facts(session, "test").get("camera/main")),
        (PROGRESS, Progress("none", (), ()), lambda session: ask_progress(session, "test").get("camera/main")),
        (CLOCK, ClockReading("box", 0), lambda session: clock_offset(session, "test", "camera", "main", trips=1)),
    ],
    ids=["facts", "progress", "clock"],
)
def test_an_answer_that_names_another_key_is_nobodys(last_part, told, ask, session, settings, until):
    own = f"suturegrasp/test/camera/main/{last_part}"
    names, answered = [own], []

    def answer(query):
        query.reply(own, encode(told), encoding=encoding_of(type(told), names[0]))
        answered.append(names[0])

    with open_session(settings) as receiver, receiver.declare_queryable(own, answer):
        until(lambda: ask(session))
        names[0] = OTHER
        assert ask(session) is None
        assert OTHER in answered
