"""The counts behind health, on message sequences whose losses are known; and which failure of a step holds how long."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.runtime.accounts import LIKE_PER_LINE, SHOWN_S, Faults, InputAccount, OutputAccount, RingLosses, StepTimes
from shared.runtime.attachment import Attachment

MS, ROOM = 1_000_000, 3


def beside(sequence, epoch=1, published_ns=0):
    return Attachment(epoch, sequence, published_ns, 0.0)


def arrived(account, *sequences, key="a", epoch=1):
    for sequence in sequences:
        account.arrived(key, beside(sequence, epoch), 0, 0.0)


@given(kept=st.sets(st.integers(0, 40), min_size=1))
def test_what_lies_between_two_messages_and_never_came_is_missed_unless_it_was_dropped_here(kept):
    account = InputAccount("t")
    arrived(account, *sorted(kept))
    absent = max(kept) - min(kept) + 1 - len(kept)
    for dropped in (0, 2):
        health = account.health(dropped, 0.0)
        assert (health.received, health.dropped, health.missed) == (len(kept), dropped, max(0, absent - dropped))


@given(steps=st.lists(st.sampled_from(["arrives", "is lost", "is taken"]), max_size=80))
def test_what_a_ring_overwrote_is_never_said_to_be_lost_on_the_way(steps):
    losses, ring, sent, lost, overwritten, taken = RingLosses(ROOM), deque(), 1, 0, 0, 1

    def take():
        if not ring:
            losses.emptied()
            return 0
        losses.taken("a", beside(ring.popleft()))
        return 1

    losses.taken("a", beside(0))
    for step in steps:
        if step == "is taken":
            taken += take()
            continue
        if step == "is lost":
            lost += 1
        else:
            overwritten += len(ring) == ROOM
            ring = deque([*ring, sent][-ROOM:])
        sent += 1
    # a last one arrives, so that every gap shows
    overwritten += len(ring) == ROOM
    ring = deque([*ring, sent][-ROOM:])
    while ring:
        taken += take()
    losses.emptied()
    assert losses.lost <= lost
    assert losses.lost + losses.overwritten == lost + overwritten == sent + 1 - taken


def test_where_the_ring_was_never_full_every_number_that_is_missing_was_lost_on_the_way_and_health_says_so():
    losses = RingLosses(ROOM)
    for number in (0, 2, 7):
        losses.taken("a", beside(number))
        losses.taken("b", beside(0, epoch=number))
        losses.emptied()
    assert (losses.lost, losses.overwritten) == (5, 0)
    newest = InputAccount("t", RingLosses(ROOM, lost=2, overwritten=5))
    arrived(newest, 0, 20)
    assert (newest.health(3, 0.0).missed, newest.health(3, 0.0).dropped) == (2, 8)
    # events that Zenoh reports as lost, though no gap shows them
    events = InputAccount("t", missed=3)
    arrived(events, 0, 2)
    assert events.health(0, 0.0).missed == 3


def test_each_key_and_each_run_of_its_publisher_has_a_sequence_of_its_own_and_a_refused_message_is_not_missed():
    account = InputAccount("t")
    for number in range(5):
        arrived(account, number, key="a")
        arrived(account, 100 + number, key="b")
    arrived(account, 0, 1, key="a", epoch=2)
    arrived(account, 500, key="a", epoch=1)
    account.refuse("a", beside(501))
    account.refuse("a", None)
    arrived(account, 502)
    # one that was only remembered, and could not be read when it was needed
    account.refuse("a", beside(502), counted=True)
    health = account.health(0, 0.0)
    assert (health.received, health.refused, health.missed) == (13, 3, 0)


@pytest.mark.parametrize("hz", [1, 30])
def test_an_output_counts_its_rate_which_falls_to_nothing_and_an_input_its_age_since_publication(hz):
    output = OutputAccount("t")
    for time_s in np.arange(0, 10, 1 / hz):
        output.count(float(time_s))
    health = output.health(10.0 - 0.5 / hz)
    assert (health.published, health.rate_hz) == (10 * hz, pytest.approx(hz, rel=0.02))
    assert output.health(20.0).rate_hz == 0
    account = InputAccount("t")
    assert account.health(0, 0.0).age_ms is None
    account.arrived("a", beside(0, published_ns=100 * MS), 130 * MS, 0.0)
    assert account.health(0, 0.0).age_ms == pytest.approx(30.0)


@given(steps=st.lists(st.floats(0, 1e6), min_size=1, max_size=40), share=st.floats(0, 100))
def test_step_times_are_percentiles_of_the_last_steps(steps, share):
    times = StepTimes()
    assert times.percentiles(50, 99) == (None, None)
    # of long ago
    for ms in (*[1e9] * 300, *(steps * 300)[-300:]):
        times.add(ms)
    assert times.percentiles(share) == pytest.approx((float(np.percentile((steps * 300)[-300:], share)),))


def test_a_failure_holds_until_a_step_of_its_kind_goes_well_and_is_shown_for_a_while():
    faults = Faults()
    assert faults.failed("camera/frames", "no left image", 0.0)
    faults.went_well("tick")
    assert not faults.ended(2 * SHOWN_S)
    faults.went_well("camera/frames")
    assert faults.text == "no left image"
    assert [faults.ended(at_s) for at_s in (0.5 * SHOWN_S, 2 * SHOWN_S, 3 * SHOWN_S)] == [False, True, False]
    assert (faults.text, faults.count) == ("", 1)
    # what nothing like it follows holds for no longer than it is shown
    faults.failed("operator/goal", "no such place", 0.0, alone=True)
    assert [faults.ended(at_s) for at_s in (0.5 * SHOWN_S, 2 * SHOWN_S)] == [False, True]


def test_a_failure_that_comes_and_goes_holds_all_along_and_has_a_line_in_the_log_now_and_then():
    faults, logged = Faults(), []
    for number in range(2 * LIKE_PER_LINE):
        logged += [number] if faults.failed("tick", "late", float(number)) else []
        faults.went_well("tick")
        assert not faults.ended(number + 0.5)
    assert (faults.count, logged) == (2 * LIKE_PER_LINE, [0, LIKE_PER_LINE])
    assert faults.failed("tick", "blind", 0.0)
