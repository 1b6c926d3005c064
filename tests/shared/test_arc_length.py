import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import make_interp_spline, make_lsq_spline

from shared.arc_length import even_parameters, length, lengths_until, parameters_at
from shared.splines import clamped_uniform_knots, evaluate

KNOTS = clamped_uniform_knots(20)
NUMBERS = st.floats(-1e308, 1e308) | st.floats(-10, 10) | st.just(0.0)
CONTROL_POINTS = st.integers(4, 24).flatmap(lambda m: arrays(np.float64, (m, 3), elements=st.floats(-10, 10)))


def fitted(curve, control_points=20):
    """The spline nearest to a curve over [0, 1], by SciPy."""
    knots, s = clamped_uniform_knots(control_points), np.linspace(0, 1, 2000)
    return knots, make_lsq_spline(s, curve(s), knots, 3).c


def polyline_length(knots, P, until=1.0, points=60_001):
    curve = evaluate(knots, P, 3, np.linspace(0, until, points))
    return np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()


@given(seed=st.integers(0, 999))
def test_length_along_a_straight_line_is_the_distance_from_its_start(seed):
    rng = np.random.default_rng(seed)
    along = np.concatenate(([0], np.cumsum(rng.uniform(0.1, 3, 19))))
    direction = rng.normal(size=3)
    s = rng.uniform(0, 1, 30)
    P = along[:, None] * direction
    expected = np.linalg.norm(evaluate(KNOTS, P, 3, s), axis=1)
    assert np.allclose(lengths_until(KNOTS, P, 3, s), expected, rtol=1e-12)
    assert np.isclose(length(KNOTS, P, 3), along[-1] * np.linalg.norm(direction), rtol=1e-12)


def test_length_of_a_fitted_parabola_is_the_closed_form():
    knots, P = fitted(lambda s: np.column_stack((s, s**2, 0 * s)), control_points=4)
    s = np.linspace(0, 1, 11)
    closed = (2 * s * np.sqrt(1 + 4 * s**2) + np.arcsinh(2 * s)) / 4
    assert np.allclose(lengths_until(knots, P, 3, s), closed, rtol=0, atol=1e-9)


def winding(rng):
    return make_interp_spline(np.linspace(0, 1, 8), rng.normal(size=(8, 3)))(np.linspace(0, 1, 20))


@pytest.mark.parametrize("seed", range(2))
def test_length_of_a_winding_curve_is_that_of_a_fine_polyline(seed):
    rng = np.random.default_rng(seed)
    P = winding(rng)
    for until in (0.1234, 1.0):
        ours = lengths_until(KNOTS, P, 3, np.array([until]))[0]
        assert ours == pytest.approx(polyline_length(KNOTS, P, until), rel=2e-6)
    cusps = rng.normal(size=(20, 1)) * [[1.0, 2.0, 3.0]]
    assert length(KNOTS, cusps, 3) == pytest.approx(polyline_length(KNOTS, cusps), rel=2e-3)


@given(P=CONTROL_POINTS, s=st.lists(st.floats(-0.5, 1.5), min_size=2, max_size=30))
def test_length_never_decreases_along_any_curve_and_stays_within_the_whole(P, s):
    knots = clamped_uniform_knots(len(P))
    lengths = lengths_until(knots, P, 3, np.append(np.sort(s), 1.0))
    assert lengths[0] >= 0
    assert (np.diff(lengths) >= 0).all()


@given(P=CONTROL_POINTS, share=st.lists(st.floats(0, 1), min_size=1, max_size=20).map(np.array))
def test_parameters_at_an_arc_length_have_that_arc_length(P, share):
    knots = clamped_uniform_knots(len(P))
    total = length(knots, P, 3)
    s = parameters_at(knots, P, 3, share * total)
    assert (s >= 0).all()
    assert (s <= 1).all()
    assert np.allclose(lengths_until(knots, P, 3, s), share * total, rtol=0, atol=2e-3 * total)


def test_parameters_of_a_winding_curve_are_exact_and_beyond_its_ends_those_of_the_ends():
    rng = np.random.default_rng(0)
    P = winding(rng)
    arc_lengths = np.sort(rng.uniform(0, length(KNOTS, P, 3), 50))
    s = parameters_at(KNOTS, P, 3, arc_lengths)
    assert np.allclose(lengths_until(KNOTS, P, 3, s), arc_lengths, rtol=0, atol=1e-7 * arc_lengths[-1])
    assert np.allclose(parameters_at(KNOTS, P, 3, np.array([-1.0, 1e6])), [0, 1], atol=1e-12)


def test_even_parameters_cut_a_curve_into_chords_of_one_length():
    knots, P = fitted(lambda s: 5 * np.column_stack((np.cos(6 * s**2), np.sin(6 * s**2), s)))
    points = evaluate(knots, P, 3, even_parameters(knots, P, 3, 2000))
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert chords == pytest.approx(chords.mean(), rel=2e-4)
    assert np.allclose(points[[0, -1]], P[[0, -1]], atol=1e-9)


@given(data=st.data(), m=st.integers(4, 12))
@settings(max_examples=25)
def test_control_points_of_any_size_give_lengths_and_parameters_without_an_exception(data, m):
    P = data.draw(arrays(np.float64, (m, 3), elements=NUMBERS))
    knots, s = clamped_uniform_knots(m), np.linspace(0, 1, 9)
    lengths = lengths_until(knots, P, 3, s)
    assert not np.isnan(lengths).any()
    even = even_parameters(knots, P, 3, 9)
    assert ((even >= 0) & (even <= 1)).all()


def test_curves_without_length_without_numbers_and_without_bounds_have_an_answer_too():
    for P in (np.zeros((20, 3)), np.full((20, 3), 7.0)):
        assert length(KNOTS, P, 3) == pytest.approx(0, abs=1e-12)
    assert np.array_equal(even_parameters(KNOTS, np.zeros((20, 3)), 3, 5), np.linspace(0, 1, 5))
    for bad in (np.nan, np.inf):
        spoilt = np.ones((20, 3))
        spoilt[3, 1] = bad
        assert np.isnan(length(KNOTS, spoilt, 3))
    assert length(KNOTS, np.outer(np.tile([1e308, -1e308], 10), np.ones(3)), 3) == np.inf
