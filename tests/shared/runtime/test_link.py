"""How fast much comes across a link, told by round trips of which the time is known."""

import pytest

from shared.runtime.facts import ANSWER_WAIT_S, FRAME_BYTES, LEAST_BYTES, MEASURED_S, throughput

LATENCY_S = 0.002


class Wire:
    """A link of so many bytes a second, which holds some back before it slows down, as token buckets do."""

    def __init__(self, rate, burst=0):
        self._rate, self._burst, self.asked, self.busy_s = rate, burst, [], 0.0

    def trip_s(self, count):
        self.asked.append(count)
        slow_s = max(0, count - self._burst) / self._rate
        self.busy_s += min(slow_s, ANSWER_WAIT_S)
        return LATENCY_S + slow_s if slow_s < ANSWER_WAIT_S else None


@pytest.mark.parametrize("rate", [1e5, 1e6, 1.25e7, 1e9])
def test_the_rate_of_a_link_comes_out_and_no_trip_holds_it_up_for_longer_than_is_needed_to_tell(rate):
    wire = Wire(rate)
    assert throughput(wire.trip_s, LATENCY_S) == pytest.approx(rate)
    assert max(wire.asked) <= max(LEAST_BYTES, 0.1 * rate)
    assert wire.busy_s < 2 * MEASURED_S
    # a fast one is measured with a whole frame
    assert (max(wire.asked) == FRAME_BYTES) == (rate == 1e9)


def test_what_is_waited_for_in_vain_bounds_the_rate():
    assert throughput(Wire(1e4).trip_s, LATENCY_S) == LEAST_BYTES / ANSWER_WAIT_S
    assert throughput(Wire(1e4, burst=LEAST_BYTES).trip_s, LATENCY_S) == 4 * LEAST_BYTES / ANSWER_WAIT_S


def test_one_trip_that_was_held_up_changes_nothing():
    wire, held_up = Wire(1e9), iter([0.1])
    assert throughput(lambda count: (wire.trip_s(count) or 0.0) + next(held_up, 0.0), LATENCY_S) == pytest.approx(1e9)
