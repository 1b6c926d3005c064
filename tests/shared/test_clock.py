import itertools
import types

import pytest

import shared.clock
from shared.clock import Stopwatch


def test_steps_count_their_milliseconds_lie_within_others_and_may_fail_and_unnamed_ones_are_refused(monkeypatch):
    # two milliseconds from one reading to the next; threads of other tests go on reading the other clocks
    readings = itertools.count(start=5_000_000, step=2_000_000)
    clock = types.SimpleNamespace(**{**vars(shared.clock.time), "perf_counter_ns": lambda: next(readings)})
    monkeypatch.setattr(shared.clock, "time", clock)
    stopwatch = Stopwatch("all", "solve", "match", "never")
    for _ in range(3):
        with stopwatch.step("all"), stopwatch.step("solve"):
            pass
    with pytest.raises(RuntimeError, match="no match"), stopwatch.step("match"):
        raise RuntimeError("no match")
    assert stopwatch.ms == pytest.approx({"all": 18.0, "solve": 6.0, "match": 2.0, "never": 0.0})
    with pytest.raises(KeyError, match="look"), stopwatch.step("look"):
        pass
