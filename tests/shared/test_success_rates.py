"""Rates, intervals and tests against SciPy and closed forms."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from shared.success_rates import difference_over_threads, mcnemar, wilson


@settings(max_examples=15)
@given(st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_of_a_rate_is_scipys(counts):
    successes, trials = counts
    expected = binomtest(successes, trials).proportion_ci(method="wilson")
    assert wilson(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-12)


@settings(max_examples=15)
@given(st.integers(0, 80), st.integers(0, 80))
def test_the_paired_test_is_scipys_binomial(first_only, second_only):
    differ = first_only + second_only
    expected = binomtest(first_only, differ).pvalue if differ else None
    assert mcnemar(first_only, second_only) == (None if expected is None else pytest.approx(expected, rel=1e-9))


@pytest.mark.parametrize(
    "counts",
    [[(18, 20, 20, 20), (14, 20, 19, 20), (20, 20, 16, 20)], [(1, 2, 5, 5), (7, 9, 3, 4), (0, 3, 3, 3), (9, 9, 8, 9)]],
)
def test_the_interval_over_threads_is_that_of_every_way_to_draw_them(counts):
    counts = np.array(counts)
    draws = np.array(list(itertools.product(range(len(counts)), repeat=len(counts))))
    sums = counts[draws].sum(axis=1)
    every = np.sort(sums[:, 2] / sums[:, 3] - sums[:, 0] / sums[:, 1])
    found = difference_over_threads(counts, seed=3)
    # the ends are steps of what can be drawn at all, one of which may be as likely as 1/27
    low, high = np.percentile(every, [1, 94], method="lower"), np.percentile(every, [6, 99], method="higher")
    assert found is not None
    assert low[0] <= found.low <= high[0]
    assert low[1] <= found.high <= high[1]


def test_without_trials_nothing_is_told_and_little_of_threads_that_are_alike_or_one():
    assert wilson(0, 0) is None
    assert mcnemar(0, 0) is None
    assert difference_over_threads(np.array([(9, 10, 10, 10)] * 4)) == pytest.approx((0.1, 0.1))
    assert difference_over_threads(np.array([(9, 10, 10, 10)])) is None
    assert difference_over_threads(np.array([(9, 10, 10, 10), (5, 5, 0, 0)])) is None
