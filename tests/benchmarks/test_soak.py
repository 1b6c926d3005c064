"""Trends of memory whose course is known."""

import numpy as np
import pytest

from benchmarks.soak import trend

AT_S = np.arange(0.0, 3600.0, 5.0)
MB = 1e6


def samples(percent_per_hour, noise_mb=0.3, at_s=AT_S):
    """Of 100 MB, with noise that goes slowly up and down as allocators do."""
    slow = np.convolve(np.random.default_rng(1).normal(size=len(at_s) + 20), np.ones(21) / 21**0.5, "valid")
    return (100.0 + percent_per_hour * at_s / 3600.0 + noise_mb * slow) * MB


@pytest.mark.parametrize(("percent", "judged"), [(0.0, "flat"), (1.0, "flat"), (5.0, "grows"), (-5.0, "shrinks")])
def test_an_hour_tells_what_is_flat(percent, judged):
    found = trend(AT_S, samples(percent))
    assert found.judgement == judged
    assert found.percent_per_hour == pytest.approx(percent, abs=5 * found.within)
    assert found.first_mb == pytest.approx(100.0, abs=2.0)
    assert found.last_mb - found.first_mb == pytest.approx(0.9 * percent, abs=1.0)


def test_a_few_minutes_of_noise_tell_nothing():
    short = AT_S[:60]
    assert trend(short, samples(0.0, noise_mb=2.0, at_s=short)).judgement == "not sure"
