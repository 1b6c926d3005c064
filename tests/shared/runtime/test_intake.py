"""What waits for an agent: in the order of its urgency, or as it came until somebody wants to know of it."""

import logging

import pytest

from schemas.topics import FRAMES, HOLD, PLAN, key
from shared.clock import monotonic_s
from shared.runtime.agent import Input
from shared.runtime.attachment import encoding_of
from shared.runtime.clocks import AgentClock
from shared.runtime.delivery import MOST, RouterLinks, Unlooked, declare_publisher
from shared.runtime.intake import Arrival, Inbox, Intake
from tests.shared.runtime.conftest import Idle, beside

KEY = key("test", FRAMES)


def test_holds_come_first_but_not_without_bound_then_events_in_order_then_the_newest_of_each_key():
    inbox, read = Inbox(), []

    def arrival(topic, number, key="a"):
        return Arrival(topic, key, lambda: read.append(number) or b"", b"")

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


def test_samples_wait_until_somebody_looks_or_there_are_too_many_or_one_may_not_wait():
    found, urgent = [], []
    unlooked = Unlooked(lambda sample, _: found.append(sample), lambda: found.append(None), lambda: bool(urgent))
    for number in range(MOST - 1):
        unlooked.put(number)
    assert found == []
    # the ring was seen empty
    unlooked.put(None)
    assert found == [*range(MOST - 1), None]
    unlooked.put("before")
    urgent.append("now")
    unlooked.put("now")
    urgent.clear()
    unlooked.put("later")
    assert found[MOST:] == ["before", "now"]
    unlooked.look()
    assert found[MOST:] == ["before", "now", "later"]


class Remembers(Idle):
    inputs = (Input(FRAMES, only_newest_counts=True, only_remembered=True),)


@pytest.fixture
def hearing(receiver, session, heard_by_others, keep):
    """An intake that hears, and a way to publish to it."""
    intake = Intake(Remembers(), AgentClock(), logging.getLogger("suturegrasp.test"))
    keep(*intake.listen(receiver, "test", RouterLinks()))
    heard_by_others(session, KEY)
    publisher = keep(declare_publisher(session, KEY, FRAMES))
    return intake, lambda number: publisher.put(b"frame", attachment=beside(number))


def test_the_newest_is_remembered_and_all_are_counted_at_their_age_whoever_asks(hearing, until, monkeypatch):
    intake, publish = hearing
    # as if each had come long before anybody looks
    monkeypatch.setattr("shared.runtime.delivery.monotonic_s", lambda: monotonic_s() - 10.0)
    publish(0)
    until(lambda: [arrival.attachment for arrival in intake.remembered()] == [beside(0)])
    publish(1)
    until(lambda: intake.handled.listed()[0].sequence == 1, "progress to tell of what waits")
    publish(2)
    until(lambda: intake.health(monotonic_s())[0].received == 3, "health to tell of what waits")
    (newest,) = intake.remembered()
    assert newest.attachment == beside(2)
    assert intake.remembered() == []
    assert intake.inbox.take(0.0) is None
    assert intake.account(FRAMES).age_ms < AgentClock().now_ns() * 1e-6 - 9_000.0


def test_what_names_another_key_is_refused_and_not_remembered(hearing, session, until):
    intake, _ = hearing
    meant = key("test", FRAMES, "other")
    session.put(KEY, b"foreign", encoding=encoding_of(FRAMES.message, meant))
    arrival = until(lambda: intake.remembered() or intake.inbox.take(0.01), "the refusal")
    assert arrival.named == meant
    assert intake.account(FRAMES).received == 0
