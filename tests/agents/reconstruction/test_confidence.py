import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.reconstruction.confidence import assumed_unit, confidence_along

PLACES = np.linspace(0, 1, 11)
BOUNDS = st.lists(st.floats(1e-9, 1e9), min_size=5, max_size=5).map(np.array)


def confidence_of(bound_depth, unit_m=1e-3):
    return confidence_along(np.array([0.5]), np.array([0.0, 0.5, 1.0]), np.full(3, bound_depth), 1.0, unit_m)[0]


@pytest.mark.parametrize(
    ("bound_mm", "expected"),
    [(0.1, 1.0), (1.5, 1.0), (4.0, np.exp(-0.5)), (6.5, np.exp(-2.0)), (1e6, 0.0)],
)
def test_confidence_is_flat_up_to_three_millimetres_of_extent_and_then_a_gaussian_of_five(bound_mm, expected):
    assert confidence_of(bound_mm) == pytest.approx(expected, rel=1e-12)


@given(first=st.floats(1e-9, 1e9), second=st.floats(1e-9, 1e9))
def test_a_larger_bound_never_has_more_confidence(first, second):
    assert confidence_of(min(first, second)) >= confidence_of(max(first, second))


@given(bounds=BOUNDS, unit_m=st.sampled_from((1e-300, 1e-6, 1e-3, 1.0, 1e300)))
def test_confidence_lies_within_zero_and_one_whatever_the_unit(bounds, unit_m):
    confidence = confidence_along(PLACES, np.sort(np.resize(PLACES, 5)), bounds, 100.0, unit_m)
    assert ((confidence >= 0) & (confidence <= 1)).all()


@given(bounds=BOUNDS)
def test_the_same_bounds_in_metres_and_in_millimetres_have_the_same_confidence(bounds):
    at = np.linspace(0, 1, 5)
    in_millimetres = confidence_along(PLACES, at, bounds, 80.0, 1e-3)
    assert np.allclose(in_millimetres, confidence_along(PLACES, at, bounds * 1e-3, 0.08, 1.0), rtol=1e-9, atol=1e-300)


def test_bounds_are_interpolated_between_regions_and_held_beyond_them():
    at = np.array([0.0, 0.2, 0.5, 0.8, 1.0])
    confidence = confidence_along(at, np.array([0.2, 0.8]), np.array([2.0, 6.0]), 0.0, 1e-3)
    assert np.allclose(confidence, [confidence_of(b) for b in (2.0, 2.0, 4.0, 6.0, 6.0)], rtol=1e-12)


@given(factor=st.floats(1e-6, 1e6))
def test_in_an_arbitrary_unit_confidence_depends_on_the_share_of_the_working_distance(factor):
    depth = factor * np.array([11.0, 12.0, 17.0])
    assert assumed_unit(depth) * 12.0 * factor == pytest.approx(0.1)
    assert confidence_of(0.04 * 12.0 * factor, assumed_unit(depth)) == pytest.approx(np.exp(-0.5), rel=1e-9)


def test_far_from_any_region_nothing_is_sure_though_both_ends_are_well_known():
    at = np.linspace(0, 1, 101)
    confidence = confidence_along(at, np.array([0.0, 0.1, 0.7, 0.8, 0.9, 1.0]), np.full(6, 0.5), 100.0, 1e-3)
    assert confidence[[0, 10, 70, 100]] == pytest.approx(1.0)
    assert confidence[40] == pytest.approx(confidence_of(0.5 + 0.3 * 30.0), rel=1e-9)
    assert (np.diff(confidence[10:40]) <= 0).all()
    assert (np.diff(confidence[40:70]) >= 0).all()
