import itertools
import types

import pytest

import shared.clock
from shared.clock import Stopwatch


@pytest.fixture(autouse=True)
def a_clock_that_takes_two_milliseconds_from_one_reading_to_the_next(monkeypatch):
    readings = itertools.count(start=5_000_000, step=2_000_000)
    # threads of other tests go on reading the others
    clock = types.SimpleNamespace(**{**vars(shared.clock.time), "perf_counter_ns": lambda: next(readings)})
    monkeypatch.setattr(shared.clock, "time", clock)


def test_steps_count_the_milliseconds_inside_add_up_and_may_lie_within_another():
    stopwatch = Stopwatch("all", "solve", "never")
    for _ in range(3):
        with stopwatch.step("all"), stopwatch.step("solve"):
            pass
    assert stopwatch.ms == {"all": pytest.approx(18.0), "solve": pytest.approx(6.0), "never": 0.0}


def test_a_step_that_fails_counts_its_failure_comes_through_and_one_that_was_not_named_is_refused():
    stopwatch = Stopwatch("match")
    with pytest.raises(RuntimeError, match="no match"), stopwatch.step("match"):
        raise RuntimeError("no match")
    assert stopwatch.ms["match"] == pytest.approx(2.0)
    with pytest.raises(KeyError, match="solve"), stopwatch.step("solve"):
        pass
