"""The median against NumPy's."""

import math

import numpy as np
import pytest

from agents.reconstruction.refined.medians import median


@pytest.mark.parametrize("count", [1, 2, 3, 8, 500, 501])
def test_it_is_numpys_to_the_last_bit_and_none_of_nothing(count):
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == np.median(values)
    assert math.isnan(median(np.append(values, np.nan)))
    assert math.isnan(median(values[:0]))
