"""How sure each part of a thread is, from the depth bounds of the regions around it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.reconstruction.confidence import assumed_unit, confidence_along

PLACES = np.linspace(0, 1, 11)
BOUNDS = st.lists(st.floats(1e-9, 1e9), min_size=5, max_size=5).map(np.array)


def confidence_of(bound_depth, unit_m=1e-3):
    return confidence_along(np.array([0.5]), np.array([0.0, 0.5, 1.0]), np.full(3, bound_depth), 1.0, unit_m)[0]


def test_confidence_is_flat_up_to_three_millimetres_of_extent_and_then_a_gaussian_of_five():
    found = [confidence_of(bound_mm) for bound_mm in (0.1, 1.5, 4.0, 6.5, 1e6)]
    assert found == pytest.approx([1.0, 1.0, np.exp(-0.5), np.exp(-2.0), 0.0], rel=1e-12)


@given(bounds=BOUNDS, unit_m=st.sampled_from((1e-300, 1e-6, 1e-3, 1.0, 1e300)))
def test_confidence_is_a_share_that_no_larger_bound_raises_whatever_the_unit(bounds, unit_m):
    narrow, wide = (
        confidence_along(PLACES, np.linspace(0, 1, 5), factor * bounds, 100.0, unit_m) for factor in (1.0, 2.0)
    )
    assert ((narrow >= 0) & (narrow <= 1)).all()
    assert (wide <= narrow).all()


@given(bounds=BOUNDS)
def test_the_same_bounds_in_metres_and_in_millimetres_have_the_same_confidence(bounds):
    at = np.linspace(0, 1, 5)
    in_millimetres = confidence_along(PLACES, at, bounds, 80.0, 1e-3)
    assert np.allclose(in_millimetres, confidence_along(PLACES, at, bounds * 1e-3, 0.08, 1.0), rtol=1e-9, atol=1e-300)


def test_bounds_are_interpolated_between_regions_held_beyond_them_and_widened_far_from_any():
    at = np.array([0.0, 0.2, 0.5, 0.8, 1.0])
    confidence = confidence_along(at, np.array([0.2, 0.8]), np.array([2.0, 6.0]), 0.0, 1e-3)
    assert np.allclose(confidence, [confidence_of(b) for b in (2.0, 2.0, 4.0, 6.0, 6.0)], rtol=1e-12)
    known = np.array([0.0, 0.1, 0.7, 0.8, 0.9, 1.0])
    sparse = confidence_along(np.linspace(0, 1, 101), known, np.full(6, 0.5), 100.0, 1e-3)
    assert sparse[[0, 10, 70, 100]] == pytest.approx(1.0)
    assert sparse[40] == pytest.approx(confidence_of(0.5 + 0.3 * 30.0), rel=1e-9)
    assert sparse.argmin() == 40


def test_in_an_arbitrary_unit_confidence_depends_on_the_share_of_the_working_distance():
    for factor in (1e-6, 1.0, 1e6):
        unit_m = assumed_unit(factor * np.array([11.0, 12.0, 17.0]))
        assert unit_m * 12.0 * factor == pytest.approx(0.1)
        assert confidence_of(0.04 * 12.0 * factor, unit_m) == pytest.approx(np.exp(-0.5), rel=1e-9)
