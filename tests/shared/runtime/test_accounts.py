"""The counts behind health, on message sequences whose losses are known; and which failure of a step holds how long."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.runtime.accounts import LIKE_PER_LINE, SHOWN_S, Faults, InputAccount, OutputAccount, StepTimes
from shared.runtime.attachment import Attachment

MS = 1_000_000


def beside(sequence, epoch=1, published_ns=0):
    return Attachment(epoch, sequence, published_ns, 0.0)


def came(account, *sequences, key="a", epoch=1):
    for sequence in sequences:
        account.came(key, beside(sequence, epoch))
        account.looked_at(beside(sequence, epoch), 0, 0.0)


@given(kept=st.sets(st.integers(0, 40), min_size=1))
def test_what_lies_between_two_messages_and_never_came_is_missed_whatever_was_dropped_here(kept):
    account = InputAccount("t")
    came(account, *sorted(kept))
    absent = max(kept) - min(kept) + 1 - len(kept)
    for dropped in (0, 2):
        health = account.health(dropped, 0.0)
        assert (health.received, health.dropped, health.missed) == (len(kept), dropped, absent)


def test_events_that_are_known_to_be_lost_are_missed_though_no_gap_shows_them():
    events = InputAccount("t", missed=3)
    came(events, 0, 2)
    assert events.health(0, 0.0).missed == 3


def test_each_key_and_each_run_of_its_publisher_has_a_sequence_of_its_own_and_a_refused_message_is_not_missed():
    account = InputAccount("t")
    for number in range(5):
        came(account, number, key="a")
        came(account, 100 + number, key="b")
    came(account, 0, 1, key="a", epoch=2)
    came(account, 500, key="a", epoch=1)
    # one that could not be read
    account.came("a", beside(501))
    account.refuse()
    # one with nothing beside it
    account.refuse()
    came(account, 502)
    # one that was only remembered, and could not be read when it was needed
    account.refuse(counted=True)
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
    account.looked_at(beside(0, published_ns=100 * MS), 130 * MS, 0.0)
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
