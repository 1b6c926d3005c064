"""Bytes of one topic under the key of another, or under none: nothing is delivered, it is counted, and said."""

import logging
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import encode, encoding_name
from schemas.messages import AgentFacts, ClockReading, Heartbeat, Hold, Outcome, Progress
from schemas.topics import FRAMES, HEALTH, HEARTBEAT, HOLD, LOG, PLAN, key
from shared.runtime.agent import Input
from shared.runtime.attachment import LAYOUT, Attachment, encoding_of, other_key, pack, unpack
from shared.runtime.clocks import clock_offset
from shared.runtime.commands import accepted, new_header, send_command
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher, subscribe
from shared.runtime.facts import CLOCK, FACTS, PROGRESS, ask_facts, ask_progress
from shared.runtime.lossless import is_of
from shared.runtime.taps import tap
from tests.shared.runtime.conftest import Idle, beside, frame_bytes

OWN, OTHER = key("test", PLAN), "suturegrasp/test/planner/other/plan"
FOREIGN = encoding_of(PLAN.message, OTHER)
uint64 = st.integers(0, 2**64 - 1)
attachments = st.builds(Attachment, uint64, uint64, st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False))


@given(attachments, st.binary(max_size=80).filter(lambda data: len(data) != LAYOUT.size))
def test_what_goes_beside_a_message_comes_back_as_it_was_and_nothing_else_passes_for_it(attachment, foreign):
    assert unpack(pack(attachment)) == attachment
    assert unpack(foreign) is None


def test_a_message_names_the_key_that_it_was_sent_under_or_comes_from_an_earlier_version_and_is_taken():
    named, unnamed = zenoh.Encoding(encoding_of(PLAN.message, OWN)), zenoh.Encoding(encoding_name(PLAN.message))
    assert str(named).startswith(encoding_name(PLAN.message))
    assert (other_key(named, OWN), other_key(named, OTHER)) == ("", OWN)
    assert other_key(unnamed, OTHER) == other_key(None, OTHER) == ""


def test_what_a_cache_gives_of_another_key_or_publisher_is_taken_for_no_event():
    def given_by(under=OWN, names=OWN, eid=3) -> Any:
        info = SimpleNamespace(source_id=SimpleNamespace(zid="abc", eid=eid)) if eid else None
        return SimpleNamespace(
            key_expr=under, encoding=zenoh.Encoding(encoding_of(PLAN.message, names)), source_info=info
        )

    assert is_of((OWN, "abc", 3), given_by())
    for other in (given_by(under=OTHER, names=OTHER), given_by(names=OTHER), given_by(eid=4), given_by(eid=0)):
        assert not is_of((OWN, "abc", 3), other)


@pytest.mark.parametrize("topic", [FRAMES, PLAN], ids=str)
def test_what_names_another_key_is_not_handed_over(topic, session, receiver, keep, heard_by_others, until):
    own, came, missed, refused = key("test", topic), [], [], []
    keep(subscribe(receiver, own, topic, came.append, missed.append, lambda *both: refused.append(both)))
    heard_by_others(session, own)
    publisher = keep(declare_publisher(session, own, topic))
    publisher.put(b"first", attachment=beside(0))
    numbered = until(lambda: came)[0].source_info
    source_info = zenoh.SourceInfo(numbered.source_id, 400) if numbered is not None else None
    session.put(own, b"foreign", encoding=encoding_of(topic.message, OTHER), source_info=source_info)
    until(lambda: refused)
    publisher.put(b"last", attachment=beside(1))
    until(lambda: len(came) == 2)
    assert [sample.payload.to_bytes() for sample in came] == [b"first", b"last"]
    assert (missed, refused) == ([], [(own, OTHER)])


class Bridge(Idle):
    """Hears plans, or what it is told to."""

    kind, instance = "robot_bridge", "psm1"

    def __init__(self, topic=PLAN, instance="main", tick_hz=None, **how):
        self.inputs, self.tick_hz, self.steps = (Input(topic, instance, **how),), tick_hz, []

    def step(self, arrived):
        self.steps.append(arrived)
        return ()


def test_an_agent_counts_what_names_another_key_as_refused_and_says_whose_it_is(running, session, heard, until):
    healths, log, bridge = heard(HEALTH), heard(LOG), Bridge()
    running(bridge)
    until(lambda: healths)
    until(lambda: session.put(OWN, b"foreign", encoding=FOREIGN) or healths[-1].inputs[0].refused)
    assert bridge.steps == []
    assert (healths[-1].inputs[0].received, healths[-1].inputs[0].missed) == (0, 0)
    until(lambda: any(f"it was sent under {OTHER}" in record.text for record in log))


def test_who_only_listens_counts_what_names_another_key_in_its_health(settings, session, heard, keep, until):
    healths, came = heard(HEALTH), []
    with connected(settings, 60.0) as connection:
        # two that listen to one topic refuse one message twice
        connection.listen((PLAN, LOG), came.append)
        connection.listen((PLAN,), lambda _: None)
        with connection.reporting("viewer", "main", logging.getLogger("suturegrasp.test"), str):
            assert until(lambda: healths)[-1].inputs == ()
            publisher = keep(declare_publisher(session, OWN, PLAN))
            until(lambda: publisher.put(b"its own", attachment=beside()) or came)
            session.put(OWN, b"foreign", encoding=FOREIGN)
            (told,) = until(lambda: healths[-1].inputs, "a refusal to be told")
    assert (told.topic, told.refused, told.received >= 1) == ("planner/plan", 1, True)
    assert b"foreign" not in [tapped.payload for tapped in came]


def test_what_speaks_of_another_arm_than_its_key_is_refused_by_who_hears_it(running, session, heard, until):
    healths, bridge = heard(HEALTH), Bridge(HEARTBEAT, "psm1")
    running(bridge)
    until(lambda: healths)
    own = key("test", HEARTBEAT, "psm1")

    def beat(arm, sequence):
        message = encode(Heartbeat(arm, "plan", 1, "arming"))
        session.put(own, message, encoding=encoding_of(Heartbeat, own), attachment=beside(sequence))

    until(lambda: beat("psm2", 0) or healths[-1].inputs[0].refused)
    assert bridge.steps == []
    until(lambda: beat("psm1", 1) or bridge.steps)


@pytest.mark.parametrize("of", ["another command", ""], ids=["another", "none"])
def test_the_answer_to_another_command_is_no_answer(session, receiver, keep, of):
    command, own = Hold(new_header("a test"), "psm1"), key("test", HOLD, "psm1")
    keep(receiver.declare_queryable(own, lambda query: query.reply(own, encode(accepted(of))), complete=True))
    told = send_command(session, "test", HOLD, command, "psm1", timeout_s=1.0)
    assert (told.id, told.outcome) == (command.header.id, Outcome.UNKNOWN)


NOT_TOLD = "0.1", "a", "b", "3.11", "1.10", False, "", None, None, "", "", None, None, None, 0.0, 0
ANSWERS = {
    FACTS: (AgentFacts("camera", "main", "box", 1, *NOT_TOLD), lambda s: ask_facts(s, "test").get("camera/main")),
    PROGRESS: (Progress("none", (), ()), lambda s: ask_progress(s, "test").get("camera/main")),
    CLOCK: (ClockReading("box", 0), lambda s: clock_offset(s, "test", "camera", "main", trips=1)),
}


@pytest.mark.parametrize("last_part", ANSWERS)
def test_an_answer_that_names_another_key_is_nobodys(last_part, session, receiver, keep, until):
    (told, ask), own = ANSWERS[last_part], f"suturegrasp/test/camera/main/{last_part}"
    names, answered = [own], []

    def answer(query):
        query.reply(own, encode(told), encoding=encoding_of(type(told), names[0]))
        answered.append(names[0])

    keep(receiver.declare_queryable(own, answer))
    until(lambda: ask(session))
    names[0] = OTHER
    assert ask(session) is None
    assert OTHER in answered


@pytest.mark.parametrize("remembers", [False, True])
def test_foreign_messages_are_refused_and_end_nobody(remembers, running, session, heard, heard_by_others, keep, until):
    frames, healths, own = [], heard(HEALTH), key("test", FRAMES)
    of_many = own.replace("/frames", "/*")
    tick_hz = 20.0 if remembers else None
    running(Bridge(FRAMES, tick_hz=tick_hz, only_newest_counts=True, only_remembered=remembers))
    heard_by_others(session, own)
    keep(*tap(session, "test", (FRAMES,), frames.append, lambda *_: None))

    def account_is(condition):
        return any(condition(health.inputs[0]) for health in healths if health.agent == "robot_bridge")

    session.put(own, frame_bytes())
    session.put(of_many, frame_bytes(), attachment=beside())
    session.put(own, b"damaged", attachment=beside(1))
    until(lambda: account_is(lambda a: (a.received, a.missed, a.refused + a.dropped) == (0, 0, 3)))
    for turn in range(6):
        session.put(own, frame_bytes(), attachment=beside((2**64 - 1) * (turn % 2), epoch=turn // 2))
    until(lambda: account_is(lambda a: a.received + a.dropped + a.refused == 9))
    until(lambda: len(frames) == 9)
    # one message for many keys is none of any of them, and is numbered nowhere
    assert [tapped.beside for tapped in frames if tapped.key == of_many] == [None]
