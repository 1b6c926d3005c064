"""What is only remembered waits as it came, and is known of by whoever asks: loop, health, and who awaits progress."""

import contextlib
import logging

import pytest

from schemas.topics import FRAMES, MAIN, key
from shared.clock import monotonic_s
from shared.runtime.agent import Input
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import RouterLinks, declare_publisher
from shared.runtime.intake import Intake
from shared.runtime.own_key import encoding_of
from shared.runtime.replayed_time import AgentClock
from shared.runtime.session import open_session

ASKED = {
    "the loop": lambda intake: [arrival.attachment for arrival in intake.remembered()],
    "health": lambda intake: intake.health(monotonic_s())[0].received,
    "progress": lambda intake: intake.handled.listed(),
}


class Remembers:
    kind, instance, outputs, commands, tick_hz = "planner", MAIN, (), (), None
    inputs = (Input(FRAMES, only_newest_counts=True, only_remembered=True),)
    acts = False

    def acts_on(self, _topic):
        return self.acts

    def step(self, _arrived):
        return ()


@pytest.fixture
def agent():
    return Remembers()


@pytest.fixture
def hearing(agent, settings, session, heard_by_others):
    """An intake that hears, and a way to publish to it."""
    with contextlib.ExitStack() as stack:
        receiver = stack.enter_context(open_session(settings))
        intake = Intake(agent, AgentClock(), logging.getLogger("suturegrasp.test"))
        for declared in intake.listen(receiver, "test", RouterLinks()):
            stack.callback(declared.undeclare)
        heard_by_others(session, key("test", FRAMES))
        publisher = declare_publisher(session, key("test", FRAMES), FRAMES)
        stack.callback(publisher.undeclare)
        yield intake, lambda number: publisher.put(b"frame", attachment=pack(Attachment(1, number, 0, 0.0)))


@pytest.mark.parametrize("who", ASKED)
def test_whoever_asks_alone_hears_of_what_waits(hearing, until, who):
    intake, publish = hearing
    publish(0)
    assert until(lambda: ASKED[who](intake), "what waits to be known of")


def test_the_newest_is_remembered_and_all_are_counted_when_they_came(hearing, until):
    intake, publish = hearing
    began_s = monotonic_s()
    for number in range(5):
        publish(number)
    until(lambda: intake.health(monotonic_s())[0].received == 5)
    (newest,) = intake.remembered()
    assert newest.attachment == pack(Attachment(1, 4, 0, 0.0))
    (told,) = intake.handled.listed()
    assert (told.sequence, intake.remembered()) == (4, [])
    counted = intake.account(FRAMES).rate.times
    assert len(counted) == 5 and began_s <= counted[0] <= counted[-1] <= monotonic_s()


def test_nothing_waits_while_the_agent_acts_on_it(agent, hearing, until):
    intake, publish = hearing
    publish(0)
    until(lambda: intake.remembered())
    agent.acts = True
    publish(1)
    arrival = until(lambda: intake.inbox.take(0.01), "what is acted on to come")
    assert arrival.attachment == pack(Attachment(1, 1, 0, 0.0))
    assert intake.remembered() == []


def test_what_names_another_key_is_refused_and_not_remembered(hearing, session, until):
    intake, _ = hearing
    meant = key("test", FRAMES, "other")
    session.put(key("test", FRAMES), b"foreign", encoding=encoding_of(FRAMES.message, meant))
    arrival = until(lambda: intake.remembered() or intake.inbox.take(0.01), "the refusal")
    assert arrival.named == meant
    assert intake.account(FRAMES).received == 0


def test_ages_are_those_of_the_arrival_however_late_anybody_looks(hearing, until):
    intake, publish = hearing
    publish(0)
    (waiting,) = intake._unlooked
    until(lambda: waiting._waiting)
    sample, came_s = waiting._waiting.popleft()
    # as if it had come ten seconds ago
    waiting._waiting.appendleft((sample, came_s - 10.0))
    intake.remembered()
    account = intake.account(FRAMES)
    now_ms = AgentClock().now_ns() * 1e-6
    assert account.age_ms < now_ms - 9_000.0
