"""What waits for an agent: the newest of some, all of others, in the order of their urgency."""

import threading

from schemas.topics import FRAMES, HOLD, PLAN
from shared.runtime.intake import Arrival, Inbox


def arrival(topic, number, key="a"):
    return Arrival(topic, key, lambda: bytes([number]), b"")


def taken(inbox):
    numbers = []
    while (found := inbox.take(0.0)) is not None:
        numbers.append(found.payload()[0])
    return numbers


def test_only_the_newest_of_each_key_is_handed_out_and_those_that_nobody_looked_at_are_counted():
    inbox = Inbox()
    for number in range(5):
        inbox.put_newest(arrival(FRAMES, number))
    inbox.put_newest(arrival(FRAMES, 9, key="b"))
    assert taken(inbox) == [4, 9]
    inbox.put_newest(arrival(FRAMES, 10))
    assert taken(inbox) == [10]
    assert (inbox.dropped(FRAMES), inbox.dropped(PLAN)) == (4, 0)


def test_holds_come_first_but_not_without_bound_then_events_in_order_then_the_newest():
    inbox = Inbox()
    inbox.put_newest(arrival(FRAMES, 100))
    for number in range(50):
        inbox.put(arrival(PLAN, number))
    assert [inbox.put_first(arrival(HOLD, number), most=2) for number in (200, 201, 202)] == [True, True, False]
    assert taken(inbox) == [200, 201, *range(50), 100]


def test_the_bytes_of_what_is_dropped_are_never_asked_for():
    inbox = Inbox()
    asked = []
    for number in range(3):
        inbox.put_newest(Arrival(FRAMES, "a", lambda number=number: asked.append(number) or b"x", b""))
    taken(inbox)
    assert asked == [2]


def test_wake_ends_a_wait():
    inbox = Inbox()
    found = []
    waiting = threading.Thread(target=lambda: found.append(inbox.take(600.0)), daemon=True)
    waiting.start()
    inbox.wake()
    waiting.join(60.0)
    assert found == [None]


def test_what_is_remembered_wakes_nobody_and_of_each_key_the_newest_is_kept_for_whoever_asks():
    inbox = Inbox()
    for number, key in enumerate("aabab"):
        inbox.remember(arrival(FRAMES, number, key))
    assert inbox.take(0.0) is None
    assert sorted(a.payload()[0] for a in inbox.remembered()) == [3, 4]
    assert inbox.remembered() == []
    assert inbox.dropped(FRAMES) == 0
