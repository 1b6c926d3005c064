"""What is only remembered waits as it came, and is known of by whoever asks: loop, health, and who awaits progress."""

import contextlib
import logging

import pytest

from schemas.topics import FRAMES, MAIN, key
from shared.clock import monotonic_s
from shared.runtime.agent import Agent, Input
from shared.runtime.attachment import Attachment, encoding_of, pack
from shared.runtime.clocks import AgentClock
from shared.runtime.delivery import RouterLinks, declare_publisher
from shared.runtime.intake import Intake
from shared.runtime.session import open_session


class Remembers(Agent):
    kind, instance, outputs, commands, tick_hz = "planner", MAIN, (), (), None
    inputs = (Input(FRAMES, only_newest_counts=True, only_remembered=True),)

    def step(self, arrived):
        assert arrived
        return ()


@pytest.fixture
def hearing(settings, session, heard_by_others):
    """An intake that hears, and a way to publish to it."""
    with contextlib.ExitStack() as stack:
        receiver = stack.enter_context(open_session(settings))
        intake = Intake(Remembers(), AgentClock(), logging.getLogger("suturegrasp.test"))
        for declared in intake.listen(receiver, "test", RouterLinks()):
            stack.callback(declared.undeclare)
        heard_by_others(session, key("test", FRAMES))
        publisher = declare_publisher(session, key("test", FRAMES), FRAMES)
        stack.callback(publisher.undeclare)
        yield intake, lambda number: publisher.put(b"frame", attachment=pack(Attachment(1, number, 0, 0.0)))


def test_the_newest_is_remembered_and_all_are_counted_whoever_asks(hearing, until):
    intake, publish = hearing
    publish(0)
    until(lambda: [arrival.attachment for arrival in intake.remembered()] == [pack(Attachment(1, 0, 0, 0.0))])
    publish(1)
    until(lambda: intake.handled.listed()[0].sequence == 1, "progress to tell of what waits")
    publish(2)
    until(lambda: intake.health(monotonic_s())[0].received == 3, "health to tell of what waits")
    (newest,) = intake.remembered()
    assert newest.attachment == pack(Attachment(1, 2, 0, 0.0))
    assert intake.remembered() == []


def test_what_names_another_key_is_refused_and_not_remembered(hearing, session, until):
    intake, _ = hearing
    meant = key("test", FRAMES, "other")
    session.put(key("test", FRAMES), b"foreign", encoding=encoding_of(FRAMES.message, meant))
    arrival = until(lambda: intake.remembered() or intake.inbox.take(0.01), "the refusal")
    assert arrival.named == meant
    assert intake.account(FRAMES).received == 0


def test_ages_are_those_of_the_arrival_however_late_anybody_looks(hearing, until, monkeypatch):
    intake, publish = hearing
    came = []
    monkeypatch.setattr("shared.runtime.delivery.monotonic_s", lambda: came.append(0) or monotonic_s() - 10.0)
    publish(0)
    until(lambda: came)
    until(lambda: intake.remembered())
    assert intake.account(FRAMES).age_ms < AgentClock().now_ns() * 1e-6 - 9_000.0
