"""What a publisher sent, put in order from what came live and what its cache gave when it was asked."""

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st
from zenoh import ext

from schemas.topics import PLAN, key
from shared.runtime.delivery import subscribe
from shared.runtime.lossless import (
    BEYOND_CACHE,
    FAR_AHEAD,
    MOST_HELD,
    NOTHING_KNOWN_S,
    PATIENCE_S,
    SourceOrder,
    _place_of,
)

KEY = key("test", PLAN)


def asked(source, cache, now_s):
    """What is handed over once the cache has been asked, if it is to be asked now."""
    if source.due(now_s) != 0.0:
        return []
    question = source.question()
    first = int(question[len("_sn=") : -len("..")]) if question else 0
    return source.answered([(n, n) for n in cache if n >= first], now_s)


def came(source, numbers, now_s):
    """What is handed over as these numbers come."""
    return [n for number in numbers for n in source.came(number, number, now_s)]


@given(
    st.integers(0, 30),
    st.sets(st.integers(0, 39)),
    st.lists(st.sampled_from(["live", "heartbeat", "appears", "empty", "answer"]), max_size=120),
)
def test_whatever_is_lost_and_however_often_the_cache_keeps_silent_all_comes_once_and_in_order(joined, lost, happens):
    source, heard, sent, now_s = SourceOrder(), [], joined, 0.0
    source.appeared(now_s)
    for what in (*happens, *["appears"], *["answer"] * 3):
        now_s += 0.15
        if what == "live" and sent < 40:
            sent += 1
            heard += came(source, {sent - 1} - lost, now_s)
        elif what == "heartbeat" and sent:
            source.told(sent - 1, now_s)
        elif what == "appears":
            source.appeared(now_s)
        elif what in ("empty", "answer"):
            heard += asked(source, range(sent) if what == "answer" else (), now_s + 1.0)
    assert heard == list(range(sent))
    assert source.missed == 0


def test_a_silent_cache_is_asked_again_after_longer_and_longer_pauses_until_it_answers():
    source, now_s, pauses_s = SourceOrder(), 0.0, []
    assert came(source, [5], now_s) == []
    for _ in range(8):
        pauses_s.append(source.due(now_s))
        now_s += pauses_s[-1]
        source.question()
        source.answered([], now_s)
    assert pauses_s == pytest.approx([0.0, 0.1, 0.2, 0.4, 0.8, 1.0, 1.0, 1.0])
    assert asked(source, range(6), now_s + 1.0) == list(range(6))
    assert (source.is_idle, source.missed) == (True, 0)


def test_what_the_cache_said_three_times_to_hold_no_longer_is_missed_and_counted_and_the_rest_goes_on():
    source = SourceOrder()
    assert came(source, [0, 9], 1.0) == [0]
    for now_s, cache in enumerate((range(4, 10), (), range(4, 10)), 1):
        assert asked(source, cache, float(now_s)) == []
    assert asked(source, range(4, 10), 4.0) == [4, 5, 6, 7, 8, 9]
    assert source.missed == 3
    assert came(source, [10], 4.1) == [10]
    # a publisher that really went on so far is heard from its second message on
    source, far = SourceOrder(), 2 * FAR_AHEAD
    assert came(source, [0, far, far + 1], 1.0) == [0]
    cache = range(far - 10, far + 2)
    assert [n for k in range(BEYOND_CACHE) for n in asked(source, cache, 2.0 + 2 * k)] == list(cache)
    assert source.missed == far - 11


@pytest.mark.parametrize("how", ["heartbeat", "message", "answer"])
def test_a_number_that_no_publisher_can_have_reached_is_not_waited_for_and_makes_nothing_pass_for_old(how):
    source, absurd = SourceOrder(), 2**32 - 100_797_944
    assert came(source, [0], 0.0) == [0]
    if how == "heartbeat":
        source.told(absurd, 1.0)
    elif how == "message":
        # its own number was 1
        assert source.came(absurd, 1, 1.0) == []
    else:
        source.appeared(1.0)
        source.question()
        assert source.answered([(absurd, absurd)], 1.0) == []
    heard = came(source, [2], 1.1) + asked(source, range(3), 2.0) + asked(source, range(3), 4.0)
    now_s = 4.0 + PATIENCE_S
    heard += came(source, [3], now_s) + asked(source, range(4), now_s + 2.0) + came(source, [4], now_s + 3.0)
    assert heard == [1, 2, 3, 4]
    assert (source.is_idle, source.missed) == (True, 0)


def answerless(source, now_s):
    """What is handed over, and when, where the cache keeps silent until nothing is awaited any more."""
    heard = []
    while not source.is_idle:
        now_s += 0.1
        heard += asked(source, (), now_s)
    return heard, now_s


def test_a_hole_that_nobody_fills_holds_back_what_came_after_it_for_so_long_or_so_many_and_no_longer():
    source = SourceOrder()
    came(source, [0, 3], 0.0)
    heard, now_s = answerless(source, 0.0)
    assert (heard, source.missed) == ([3], 2)
    assert PATIENCE_S < now_s < PATIENCE_S + 2
    source, many = SourceOrder(), range(1, MOST_HELD + 2)
    assert (came(source, many, 0.0), source.missed) == (list(many), 1)
    # of a publisher that has published nothing nothing is missed
    source = SourceOrder()
    source.appeared(0.0)
    heard, now_s = answerless(source, 0.0)
    assert (heard, source.missed) == ([], 0)
    assert now_s < NOTHING_KNOWN_S + 2


@given(st.permutations(range(8)))
def test_of_states_what_is_newer_goes_on_at_once_and_what_is_older_never(numbers):
    source = SourceOrder(lossless=False)
    heard = came(source, numbers, 0.0)
    assert heard == sorted(heard)
    assert heard[-1] == 7
    # one that only its heartbeat told of is asked for
    source.told(9, 1.0)
    assert asked(source, [9], 2.0) == [9]
    assert (source.is_idle, source.missed) == (True, 0)


def test_a_number_of_another_publishers_heartbeat_makes_nothing_pass_for_lost_or_old():
    source = SourceOrder()
    assert came(source, [0], 0.0) == [0]
    source.told(500, 1.0)
    for answers in range(BEYOND_CACHE):
        # answers that lost their ends do not outweigh it too soon
        assert not source.is_idle
        assert asked(source, range(1), 2.0 + 2 * answers) == []
    assert source.is_idle
    assert came(source, [1, 2], 31.0) == [1, 2]
    assert (source.missed, source.is_idle) == (0, True)


def test_what_came_to_nothing_is_asked_for_until_the_cache_has_it(session, receiver, keep, until):
    samples, missed = [], []
    # its messages come to nothing on their way; only its cache can be asked for them
    unheard = ext.declare_advanced_publisher(
        session,
        KEY,
        cache=ext.CacheConfig(1000),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.1),
        publisher_detection=True,
        allowed_destination=zenoh.Locality.SESSION_LOCAL,
    )
    keep(unheard, subscribe(receiver, KEY, PLAN, samples.append, missed.append))
    for number in range(5):
        unheard.put(str(number))
    # the token or a heartbeat tells that there is something
    until(lambda: len(samples) == 5)
    of = samples[-1].source_info.source_id
    unheard.put("5")
    until(lambda: len(samples) == 6, "a heartbeat to tell of the next")
    # a message overtakes one that its publisher's cache does not have yet either
    session.put(KEY, "7", source_info=zenoh.SourceInfo(of, 7))
    session.put(KEY, "2", source_info=zenoh.SourceInfo(of, 2))
    unheard.put("6")
    until(lambda: len(samples) == 8)
    assert [int(sample.payload.to_string()) for sample in samples] == list(range(8))
    assert missed == []


def test_a_message_of_another_topic_under_the_key_of_a_heartbeat_tells_no_number():
    told = f"{KEY}/@adv/pub/abc/3"
    assert _place_of(f"{told}/_") == (KEY, "abc", 3)
    assert [_place_of(foreign) for foreign in (f"{told}/_/main/command", f"{told}/main", KEY)] == [None] * 3
