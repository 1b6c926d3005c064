"""Each delivery class behind a real router, with receivers that are late, slow, or cut off for a while."""

import contextlib
import dataclasses
import threading

import pytest

from schemas.topics import CALIBRATION, FRAMES, PLAN, key
from shared.runtime.accounts import RingLosses
from shared.runtime.attachment import Attachment, pack, unpack
from shared.runtime.delivery import declare_publisher, ring_room, subscribe
from shared.runtime.session import SessionSettings, open_router, open_session

DEADLINE_S = 60.0


@pytest.fixture
def publish(session):
    """Publishes on a topic; the first call declares its publisher."""
    publishers = {}

    def put(topic, payload):
        if topic not in publishers:
            publishers[topic] = declare_publisher(session, key("test", topic), topic)
        publishers[topic].put(payload)

    yield put
    for publisher in publishers.values():
        publisher.undeclare()


@pytest.fixture
def listen(settings):
    """Hears a topic on a session of its own: a list of payloads, and one of reported misses."""
    with contextlib.ExitStack() as stack:

        def start(topic):
            opened = stack.enter_context(open_session(settings))
            heard, missed = [], []
            take = lambda sample: heard.append(sample.payload.to_bytes())  # noqa: E731
            for declared in subscribe(opened, key("test", topic), topic, take, missed.append):
                stack.callback(declared.undeclare)
            return heard, missed

        yield start


def test_a_late_joiner_gets_the_last_state_and_only_that(publish, listen, until):
    early, _ = listen(CALIBRATION)
    for number in range(5):
        publish(CALIBRATION, bytes([number]))
    # what is still on its way to the router would be new to whoever joins meanwhile
    until(lambda: b"\x04" in early)
    heard, _ = listen(CALIBRATION)
    until(lambda: heard)
    publish(CALIBRATION, b"new")
    until(lambda: b"new" in heard)
    assert heard == [b"\x04", b"new"]


def test_a_late_joiner_gets_as_many_events_in_order_as_the_rig_has_kept(publish, listen, until):
    more = dataclasses.replace(PLAN, kept=PLAN.kept + 500)
    sent = [number.to_bytes(2, "big") for number in range(PLAN.kept + 200)]
    for payload in sent:
        publish(more, payload)
    heard, missed = listen(more)
    until(lambda: len(heard) == len(sent))
    assert (heard, missed) == (sent, [])
    of_table, _ = listen(PLAN)
    until(lambda: of_table and of_table[-1] == sent[-1])
    assert of_table == sent[-PLAN.kept :]


def test_a_late_joiner_gets_nothing_old_of_what_counts_only_when_new(publish, listen, until):
    early, _ = listen(FRAMES)
    until(lambda: publish(FRAMES, b"old") or early)
    # all that was sent before has passed the router when this has
    publish(FRAMES, b"the last of the old")
    until(lambda: early[-1] == b"the last of the old")
    heard, _ = listen(FRAMES)
    until(lambda: publish(FRAMES, b"new") or b"new" in heard)
    assert set(heard) == {b"new"}


def test_behind_a_slow_receiver_the_newest_is_next_and_what_it_replaced_is_told_from_what_never_came(
    session, settings, heard_by_others, until
):
    topic_key, going, heard = key("test", FRAMES), threading.Event(), []
    losses = RingLosses(ring_room(topic_key))
    publisher = declare_publisher(session, topic_key, FRAMES)

    def send(*numbers):
        for number in numbers:
            publisher.put(b"", attachment=pack(Attachment(1, number, 0, 0.0)))

    def slow(sample):
        beside = unpack(sample.attachment.to_bytes())
        assert beside is not None
        heard.append(beside.sequence)
        if heard[-1] == 6:
            going.wait(DEADLINE_S)

    with open_session(settings) as receiver:
        kept = subscribe(receiver, topic_key, FRAMES, slow, lambda _: None, losses)
        heard_by_others(session, topic_key)
        # as if 1 to 4 had been lost on the way
        send(0, 5)
        until(lambda: losses.lost == 4)
        send(6)
        until(lambda: heard[-1] == 6)
        send(*range(7, 100))
        # what is sent on another key over the same link comes after
        other = subscribe(receiver, key("test", PLAN), PLAN, lambda _: heard.append("a plan"), lambda _: None)
        heard_by_others(session, key("test", PLAN))
        last = declare_publisher(session, key("test", PLAN), PLAN)
        last.put(b"")
        until(lambda: "a plan" in heard)
        going.set()
        until(lambda: 99 in heard)
        until(lambda: losses.overwritten > 0)
        for declared in (*kept, *other, publisher, last):
            declared.undeclare()
    # what waited is few and new; an agent's inbox keeps one of them
    came = [number for number in heard if number != "a plan"]
    later = [number for number in came if number > 6]
    assert later == list(range(100 - len(later), 100))
    assert len(later) <= ring_room(topic_key) + 1
    # the ring was full since, so of what is missing nobody knows where it went
    assert losses.lost == 4
    assert losses.lost + losses.overwritten == 100 - len(came)


def test_events_survive_a_restart_of_the_router_in_order_and_without_a_hole(router, until):
    heard, missed = [], []
    with contextlib.ExitStack() as stack:
        routing = contextlib.ExitStack()
        stack.push(routing)
        endpoint = routing.enter_context(router())
        settings = SessionSettings("test", endpoint)
        sender, receiver = (stack.enter_context(open_session(settings)) for _ in range(2))
        publisher = declare_publisher(sender, key("test", PLAN), PLAN)
        kept = subscribe(receiver, key("test", PLAN), PLAN, lambda s: heard.append(s.payload.to_bytes()), missed.append)
        publisher.put(b"0")
        until(lambda: heard == [b"0"])
        routing.close()
        for number in range(1, 20):
            publisher.put(str(number).encode())
        with open_router(endpoint):
            until(lambda: len(heard) == 20)
            for declared in (*kept, publisher):
                declared.undeclare()
    assert heard == [str(number).encode() for number in range(20)]
    assert missed == []


def test_no_thread_outlives_its_subscriber(session):
    name = f"receive {key('test', FRAMES)}"
    kept = subscribe(session, key("test", FRAMES), FRAMES, lambda _: None, lambda _: None)
    assert name in {thread.name for thread in threading.enumerate()}
    for declared in kept:
        declared.undeclare()
    assert name not in {thread.name for thread in threading.enumerate()}
