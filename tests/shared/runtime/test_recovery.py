"""What a publisher sent, put in order from what came live and what its cache gave when it was asked."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.runtime.lossless import BEYOND_CACHE, FAR_AHEAD, MOST_HELD, NOTHING_KNOWN_S, PATIENCE_S, SourceOrder


def asked(source, cache, now_s):
    """What is handed over once the cache has been asked, if it is to be asked now."""
    if source.due(now_s) != 0.0:
        return []
    question = source.question()
    first = int(question[len("_sn=") : -len("..")]) if question else 0
    return source.answered([(n, n) for n in cache if n >= first], now_s)


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
            heard += source.came(sent - 1, sent - 1, now_s) if sent - 1 not in lost else []
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
    assert source.came(5, 5, now_s) == []
    for _ in range(8):
        pauses_s.append(source.due(now_s))
        now_s += pauses_s[-1]
        source.question()
        source.answered([], now_s)
    assert pauses_s == pytest.approx([0.0, 0.1, 0.2, 0.4, 0.8, 1.0, 1.0, 1.0])
    assert asked(source, range(6), now_s + 1.0) == list(range(6))
    assert source.is_idle
    assert source.missed == 0


def test_what_the_cache_said_three_times_to_hold_no_longer_is_missed_and_counted_and_the_rest_goes_on():
    source = SourceOrder()
    assert source.came(0, 0, 0.0) == [0]
    assert source.came(9, 9, 1.0) == []
    assert asked(source, range(4, 10), 1.0) == []
    assert asked(source, (), 2.0) == []
    assert asked(source, range(4, 10), 3.0) == []
    assert asked(source, range(4, 10), 4.0) == [4, 5, 6, 7, 8, 9]
    assert source.missed == 3
    assert source.came(10, 10, 4.1) == [10]


@pytest.mark.parametrize("how", ["heartbeat", "message", "answer"])
def test_a_number_that_no_publisher_can_have_reached_is_not_waited_for_and_makes_nothing_pass_for_old(how):
    source, absurd = SourceOrder(), 2**32 - 100_797_944
    assert source.came(0, 0, 0.0) == [0]
    if how == "heartbeat":
        source.told(absurd, 1.0)
    elif how == "message":
        # its own number was 1
        assert source.came(absurd, 1, 1.0) == []
    else:
        source.appeared(1.0)
        source.question()
        assert source.answered([(absurd, absurd)], 1.0) == []
    heard = source.came(2, 2, 1.1) + asked(source, range(3), 2.0) + asked(source, range(3), 4.0)
    now_s = 4.0 + PATIENCE_S
    heard += source.came(3, 3, now_s) + asked(source, range(4), now_s + 2.0) + source.came(4, 4, now_s + 3.0)
    assert heard == [1, 2, 3, 4]
    assert source.missed == 0
    assert source.is_idle


def test_a_publisher_that_really_went_on_so_far_is_heard_from_its_second_message_on():
    source, far = SourceOrder(), 2 * FAR_AHEAD
    assert source.came(0, 0, 0.0) == [0]
    assert source.came(far, far, 1.0) == []
    assert source.came(far + 1, far + 1, 1.1) == []
    cache = range(far - 10, far + 2)
    heard = [n for k in range(BEYOND_CACHE) for n in asked(source, cache, 2.0 + 2 * k)]
    assert heard == list(cache)
    assert source.missed == far - 11


def test_a_hole_that_nobody_fills_holds_back_what_came_after_it_for_so_long_and_no_longer():
    source, now_s, heard = SourceOrder(), 0.0, []
    source.came(0, 0, now_s)
    source.came(3, 3, now_s)
    while not source.is_idle:
        now_s += 0.5
        heard += asked(source, (), now_s)
    assert heard == [3]
    assert source.missed == 2
    assert PATIENCE_S < now_s < PATIENCE_S + 2


def test_more_than_any_cache_holds_is_not_held_back():
    source = SourceOrder()
    heard = [n for number in range(1, MOST_HELD + 2) for n in source.came(number, number, 0.0)]
    assert heard == list(range(1, MOST_HELD + 2))
    assert source.missed == 1


def test_of_a_publisher_that_has_published_nothing_nothing_is_missed_and_asking_ends():
    source, now_s = SourceOrder(), 0.0
    source.appeared(now_s)
    while not source.is_idle:
        now_s += 0.1
        assert asked(source, (), now_s) == []
    assert now_s < NOTHING_KNOWN_S + 2
    assert source.missed == 0


@given(st.permutations(range(8)))
def test_of_states_what_is_newer_goes_on_at_once_and_what_is_older_never(numbers):
    source = SourceOrder(lossless=False)
    heard = [n for number in numbers for n in source.came(number, number, 0.0)]
    assert heard == sorted(heard)
    assert heard[-1] == 7
    # one that only its heartbeat told of is asked for
    source.told(9, 1.0)
    assert asked(source, [9], 2.0) == [9]
    assert source.is_idle
    assert source.missed == 0


def test_a_number_of_another_publisher_s_heartbeat_makes_nothing_pass_for_lost_or_old():
    source = SourceOrder()
    assert source.came(0, 0, 0.0) == [0]
    source.told(500, 1.0)
    for answers in range(BEYOND_CACHE):
        # answers that lost their ends do not outweigh it too soon
        assert not source.is_idle
        assert asked(source, range(1), 2.0 + 2 * answers) == []
    assert source.is_idle
    assert [n for number in (1, 2) for n in source.came(number, number, 30.0 + number)] == [1, 2]
    assert (source.missed, source.is_idle) == (0, True)
