"""The counts behind health, on message sequences whose losses are known."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import decode, encode
from schemas.messages import InputHealth
from shared.runtime.accounts import InputAccount, OutputAccount, Rate, RingLosses, StepTimes
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


def test_the_first_message_is_the_first_whatever_its_number():
    account = InputAccount("t")
    arrived(account, 1000)
    assert account.health(0, 0.0).missed == 0


def test_what_was_dropped_here_was_not_lost_on_the_way():
    account = InputAccount("t")
    arrived(account, 0, 5, 10)
    assert account.health(6, 0.0).missed == 2
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


def test_health_counts_the_rings_losses_with_what_the_inbox_replaced():
    account = InputAccount("t", RingLosses(ROOM, lost=2, overwritten=5))
    arrived(account, 0, 20)
    health = account.health(3, 0.0)
    assert (health.missed, health.dropped) == (2, 8)


def test_what_zenoh_reports_is_counted_though_no_gap_shows_it():
    account = InputAccount("t", missed=3)
    arrived(account, 0, 2)
    assert account.health(0, 0.0).missed == 3


def test_a_restart_of_the_publisher_is_no_gap():
    account = InputAccount("t")
    arrived(account, 7, 8)
    arrived(account, 0, 1, epoch=2)
    arrived(account, 500, epoch=1)
    assert account.health(0, 0.0).missed == 0


def test_each_key_has_a_sequence_of_its_own():
    account = InputAccount("t")
    for number in range(5):
        arrived(account, number, key="a")
        arrived(account, 100 + number, key="b")
    assert account.health(0, 0.0).missed == 0
    assert account.health(0, 0.0).received == 10


def test_a_refused_message_is_refused_and_not_missed_too():
    account = InputAccount("t")
    arrived(account, 0)
    account.refuse("a", beside(1))
    account.refuse("a", None)
    arrived(account, 2)
    health = account.health(0, 0.0)
    assert (health.received, health.refused, health.missed) == (2, 2, 0)


def test_age_is_from_publication_to_looking_at_it():
    account = InputAccount("t")
    assert account.health(0, 0.0).age_ms is None
    account.arrived("a", beside(0, published_ns=100 * MS), 130 * MS, 0.0)
    assert account.health(0, 0.0).age_ms == pytest.approx(30.0)


@pytest.mark.parametrize("hz", [1, 30, 100])
def test_a_rate_is_events_per_second_and_falls_to_nothing(hz):
    rate = Rate()
    for time_s in np.arange(0, 10, 1 / hz):
        rate.count(float(time_s))
    assert rate.hz(10.0 - 0.5 / hz) == pytest.approx(hz, rel=0.02)
    assert rate.hz(20.0) == 0


def test_an_output_counts_what_was_published():
    account = OutputAccount("t")
    for time_s in (0.0, 0.5, 1.0):
        account.count(time_s)
    health = account.health(1.0)
    assert (health.published, health.rate_hz) == (3, 1.5)


def test_step_times_are_percentiles_of_the_last_steps():
    times = StepTimes()
    assert times.percentiles(50, 99) == (None, None)
    for ms in [1000.0] * 100 + [float(n) for n in range(300)]:
        times.add(ms)
    assert times.percentiles(50, 99) == pytest.approx((149.5, 296.01))


@given(steps=st.lists(st.floats(0, 1e6), min_size=1, max_size=40), share=st.floats(0, 100))
def test_percentiles_of_step_times_are_those_of_numpy(steps, share):
    times = StepTimes()
    for ms in steps:
        times.add(ms)
    assert times.percentiles(share) == pytest.approx((float(np.percentile(steps, share)),))


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


def test_what_was_remembered_and_could_not_be_read_when_it_was_needed_counts_once():
    account = InputAccount("t")
    arrived(account, 0, 1, 2)
    account.refuse("a", beside(2), counted=True)
    health = account.health(0, 0.0)
    assert (health.received, health.refused, health.missed) == (2, 1, 0)
