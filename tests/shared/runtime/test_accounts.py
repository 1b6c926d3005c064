"""The counts behind health, on message sequences whose losses are known."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import decode, encode
from schemas.messages import InputHealth
from shared.runtime.accounts import InputAccount, OutputAccount, RingLosses, StepTimes
from shared.runtime.attachment import Attachment

MS = 1_000_000


def beside(sequence, epoch=1, published_ns=0):
    return Attachment(epoch, sequence, published_ns, 0.0)


def arrived(account, *sequences, key="a", epoch=1):
    for sequence in sequences:
        account.arrived(key, beside(sequence, epoch), 0, 0.0)


@given(kept=st.sets(st.integers(0, 40), min_size=1))
def test_what_lies_between_two_messages_and_never_came_is_missed(kept):
    account = InputAccount("t")
    arrived(account, *sorted(kept))
    health = account.health(0, 0.0)
    assert (health.received, health.missed) == (len(kept), max(kept) - min(kept) + 1 - len(kept))


def test_what_was_dropped_here_was_not_lost_on_the_way():
    account = InputAccount("t")
    arrived(account, 0, 5, 10)
    assert (account.health(6, 0.0).dropped, account.health(6, 0.0).missed) == (6, 2)
    assert account.health(8, 0.0).missed == 0


ROOM = 3


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
        elif len(ring) == ROOM:
            overwritten += 1
            ring.popleft()
            ring.append(sent)
        else:
            ring.append(sent)
        sent += 1
    # a last one arrives, so that every gap shows
    overwritten += len(ring) == ROOM
    ring = deque([*ring, sent][-ROOM:])
    while ring:
        taken += take()
    losses.emptied()
    assert losses.lost <= lost
    assert losses.lost + losses.overwritten == lost + overwritten == sent + 1 - taken


def test_where_the_ring_was_never_full_every_number_that_is_missing_was_lost_on_the_way():
    losses = RingLosses(ROOM)
    for number in (0, 2, 7):
        losses.taken("a", beside(number))
        losses.taken("b", beside(0, epoch=number))
        losses.emptied()
    assert (losses.lost, losses.overwritten) == (5, 0)


def test_health_counts_what_the_ring_lost_and_what_zenoh_reports_though_no_gap_shows_it():
    newest = InputAccount("t", RingLosses(ROOM, lost=2, overwritten=5))
    arrived(newest, 0, 20)
    assert (newest.health(3, 0.0).missed, newest.health(3, 0.0).dropped) == (2, 8)
    events = InputAccount("t", missed=3)
    arrived(events, 0, 2)
    assert events.health(0, 0.0).missed == 3


def test_each_key_and_each_run_of_its_publisher_has_a_sequence_of_its_own():
    account = InputAccount("t")
    for number in range(5):
        arrived(account, number, key="a")
        arrived(account, 100 + number, key="b")
    arrived(account, 0, 1, key="a", epoch=2)
    arrived(account, 500, key="a", epoch=1)
    health = account.health(0, 0.0)
    assert (health.received, health.missed) == (13, 0)


def test_a_refused_message_is_counted_once_and_not_missed_too():
    account = InputAccount("t")
    arrived(account, 0)
    account.refuse("a", beside(1))
    account.refuse("a", None)
    arrived(account, 2, 3)
    # one that was only remembered, and could not be read when it was needed
    account.refuse("a", beside(3), counted=True)
    health = account.health(0, 0.0)
    assert (health.received, health.refused, health.missed) == (2, 3, 0)


def test_age_is_from_publication_to_looking_at_it():
    account = InputAccount("t")
    assert account.health(0, 0.0).age_ms is None
    account.arrived("a", beside(0, published_ns=100 * MS), 130 * MS, 0.0)
    assert account.health(0, 0.0).age_ms == pytest.approx(30.0)


@pytest.mark.parametrize("hz", [1, 30])
def test_an_output_counts_what_was_published_and_its_rate_which_falls_to_nothing(hz):
    account = OutputAccount("t")
    for time_s in np.arange(0, 10, 1 / hz):
        account.count(float(time_s))
    health = account.health(10.0 - 0.5 / hz)
    assert (health.topic, health.published) == ("t", 10 * hz)
    assert health.rate_hz == pytest.approx(hz, rel=0.02)
    assert account.health(20.0).rate_hz == 0


@given(steps=st.lists(st.floats(0, 1e6), min_size=1, max_size=40), share=st.floats(0, 100))
def test_step_times_are_percentiles_of_the_last_steps(steps, share):
    times = StepTimes()
    assert times.percentiles(50, 99) == (None, None)
    # of long ago
    for ms in (*[1e9] * 300, *(steps * 300)[-300:]):
        times.add(ms)
    assert times.percentiles(share) == pytest.approx((float(np.percentile((steps * 300)[-300:], share)),))


@given(ahead=st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=20))
def test_whatever_numbers_are_claimed_health_can_be_told(ahead):
    ring = RingLosses(ROOM)
    latest, event = InputAccount("t", ring), InputAccount("t")
    for sequence in (*ahead, 0, 2**64 - 1, 0, 2**64 - 1):
        ring.taken("a", beside(sequence))
        ring.emptied()
        arrived(latest, sequence)
        arrived(event, sequence)
    told = (latest.health(0, 0.0), event.health(0, 0.0))
    assert [decode(InputHealth, encode(health)) for health in told] == list(told)
    assert event.health(0, 0.0).missed > 2**60
