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


def test_a_step_that_was_never_taken_counts_zero():
    assert Stopwatch("match", "solve").ms == {"match": 0.0, "solve": 0.0}


def test_a_step_counts_the_milliseconds_inside_and_adds_up():
    stopwatch = Stopwatch("match", "solve")
    for _ in range(3):
        with stopwatch.step("match"):
            pass
    assert stopwatch.ms == {"match": pytest.approx(6.0), "solve": 0.0}


def test_a_step_within_a_step_counts_for_both():
    stopwatch = Stopwatch("all", "solve")
    with stopwatch.step("all"), stopwatch.step("solve"):
        pass
    assert stopwatch.ms == {"all": pytest.approx(6.0), "solve": pytest.approx(2.0)}


def test_a_step_that_fails_counts_and_its_failure_comes_through():
    stopwatch = Stopwatch("match")
    with pytest.raises(RuntimeError, match="no match"), stopwatch.step("match"):
        raise RuntimeError("no match")
    assert stopwatch.ms["match"] == pytest.approx(2.0)


def test_a_step_that_was_not_named_is_refused():
    stopwatch = Stopwatch("match")
    with pytest.raises(KeyError, match="solve"), stopwatch.step("solve"):
        pass
