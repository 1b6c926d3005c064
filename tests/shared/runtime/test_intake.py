"""What waits for an agent, in the order of its urgency."""

import logging

import pytest

from schemas.topics import FRAMES, HOLD, PLAN, key
from shared.clock import monotonic_s
from shared.runtime.agent import Input
from shared.runtime.attachment import encoding_of
from shared.runtime.clocks import AgentClock
from shared.runtime.delivery import declare_publisher
from shared.runtime.intake import Arrival, Inbox, Intake
from tests.shared.runtime.conftest import Idle, beside

KEY = key("test", FRAMES)


def test_holds_come_first_but_not_without_bound_then_events_in_order_then_the_newest_of_each_key():
    inbox, read = Inbox(), []

    def arrival(topic, number, key="a"):
        return Arrival(topic, key, lambda: read.append(number) or b"")

    for number in range(100, 105):
        inbox.put_newest(arrival(FRAMES, number))
    inbox.put_newest(arrival(FRAMES, 109, key="b"))
    for number in range(50):
        inbox.put(arrival(PLAN, number))
    assert [inbox.put_first(arrival(HOLD, number), most=2) for number in (200, 201, 202)] == [True, True, False]
    while (found := inbox.take(0.0)) is not None:
        found.payload()
        # what was looked at is replaced by nothing
        inbox.put_newest(arrival(FRAMES, 110)) if read == [200] else None
    # the bytes of what is dropped were never asked for
    assert read == [200, 201, *range(50), 109, 110]
    assert (inbox.dropped(FRAMES), inbox.dropped(PLAN)) == (5, 0)


class Remembers(Idle):
    inputs = (Input(FRAMES, only_newest_counts=True, only_remembered=True),)


@pytest.fixture
def hearing(receiver, session, heard_by_others, keep):
    """An intake that hears, and a way to publish to it."""
    intake = Intake(Remembers(), AgentClock(), logging.getLogger("suturegrasp.test"))
    keep(*intake.listen(receiver, "test"))
    heard_by_others(session, KEY)
    publisher = keep(declare_publisher(session, KEY, FRAMES))
    return intake, lambda number: publisher.put(b"frame", attachment=beside(number))


def test_the_newest_is_remembered_and_all_are_counted(hearing, until):
    intake, publish = hearing
    publish(0)
    until(lambda: [arrival.beside.sequence for arrival in intake.inbox.remembered()] == [0])
    publish(1)
    until(lambda: intake.handled.listed()[0].sequence == 1, "progress to tell of what is remembered")
    publish(3)
    until(lambda: intake.health(monotonic_s())[0].received == 3, "health to tell of what is remembered")
    (newest,) = intake.inbox.remembered()
    assert newest.beside.sequence == 3
    assert intake.inbox.remembered() == []
    assert intake.inbox.take(0.0) is None
    assert intake.health(monotonic_s())[0].missed == 1


def test_what_names_another_key_is_refused_and_not_remembered(hearing, session, until):
    intake, _ = hearing
    meant = key("test", FRAMES, "other")
    session.put(KEY, b"foreign", encoding=encoding_of(FRAMES.message, meant))
    arrival = until(lambda: intake.inbox.remembered() or intake.inbox.take(0.01), "the refusal")
    assert arrival.named == meant
    assert intake.account(FRAMES).received == 0
