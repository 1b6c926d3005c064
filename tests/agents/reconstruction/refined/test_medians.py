"""The median against NumPy's."""

import math

import numpy as np
import pytest

from agents.reconstruction.refined.medians import median


@pytest.mark.parametrize("count", [1, 2, 3, 8, 9, 500, 501])
def test_it_is_numpys_to_the_last_bit(count):
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == np.median(values)
    assert median(np.round(values)) == np.median(np.round(values))


@pytest.mark.parametrize("values", [[], [math.nan], [1.0, math.nan, 2.0]])
def test_of_nothing_and_of_what_is_no_number_there_is_none(values):
    assert math.isnan(median(np.array(values)))
