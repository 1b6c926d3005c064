import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from shared.success_rates import difference_over_threads, mcnemar, wilson


@settings(max_examples=15)
@given(st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_of_a_rate_and_the_paired_test_are_scipys(counts):
    k, n = counts
    expected = binomtest(k, n).proportion_ci(method="wilson")
    assert wilson(k, n) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert mcnemar(k, n - k) == pytest.approx(binomtest(k, n).pvalue, rel=1e-9)


def test_the_interval_over_threads_is_that_of_every_way_to_draw_them_and_nothing_is_told_without_trials():
    # drawn twice, one of these, the other, or both: rates that differ by 0.5, 0.1 and 0.3
    counts = np.array([(5, 10, 10, 10), (8, 10, 9, 10)])
    assert difference_over_threads(counts, seed=3) == pytest.approx((0.1, 0.5))
    sixteen = difference_over_threads(np.repeat(counts, 8, axis=0))
    assert sixteen == pytest.approx((0.2, 0.4), abs=0.03)
    assert difference_over_threads(np.array([(9, 10, 10, 10), (5, 5, 0, 0)])) is None
    assert (wilson(0, 0), mcnemar(0, 0)) == (None, None)
