"""Cubic and other splines, lengths along them, and how far two curves are apart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import BSpline, make_interp_spline

from shared.arc_length import even_parameters, length, lengths_until, parameters_at
from shared.curve_distance import curve_distance, discrete_frechet, distances_to_polyline
from shared.splines import basis_matrix, clamped_uniform_knots, difference_matrix, evaluate

SIZES = ((4, 3), (5, 3), (20, 3), (22, 3), (6, 5), (3, 2), (9, 1))
PARAMETERS = st.lists(st.floats(0, 1), max_size=20).map(np.array)
KNOTS = clamped_uniform_knots(20)
NUMBERS = st.floats(-1e308, 1e308) | st.floats(-10, 10) | st.just(0.0)
CONTROL_POINTS = st.integers(4, 24).flatmap(lambda m: arrays(np.float64, (m, 3), elements=st.floats(-10, 10)))
WINDING = make_interp_spline(np.linspace(0, 1, 8), np.random.default_rng(0).normal(size=(8, 3)))(np.linspace(0, 1, 20))
POINTS = arrays(np.float64, st.tuples(st.integers(1, 12), st.just(2)), elements=st.floats(-10, 10))


@settings(max_examples=20)
@given(size=st.sampled_from(SIZES), seed=st.integers(0, 999), s=PARAMETERS, data=st.data())
def test_curve_and_derivatives_are_those_of_scipy(size, seed, s, data):
    control_points, degree = size
    derivative = data.draw(st.integers(0, degree))
    knots, P = clamped_uniform_knots(control_points, degree), np.random.default_rng(seed).normal(size=(size[0], 3))
    spline = BSpline(knots, P, degree)
    theirs = (spline.derivative(derivative) if derivative else spline)(s).reshape(-1, 3)
    differences = difference_matrix(knots, degree, derivative)
    scale = np.abs(differences).sum(axis=1).max()
    found = evaluate(knots, P, degree, s, derivative)
    assert found.shape == theirs.shape
    assert np.allclose(found, theirs, rtol=0, atol=1e-12 * scale)
    basis = basis_matrix(knots, degree, s, derivative)
    assert np.allclose(basis @ P, theirs, rtol=0, atol=1e-12 * scale)
    assert (np.count_nonzero(basis, axis=1) <= degree + 1).all()
    # beyond the ends are the ends
    beyond = evaluate(knots, P, degree, np.array([-0.5, 1.5]), derivative)
    assert np.array_equal(beyond, evaluate(knots, P, degree, np.array([0.0, 1.0]), derivative))


@pytest.mark.parametrize(("control_points", "degree"), SIZES)
def test_knots_are_evenly_spaced_between_ends_that_are_repeated_degree_plus_one_times(control_points, degree):
    knots = clamped_uniform_knots(control_points, degree)
    within = np.linspace(0, 1, control_points - degree + 1)
    assert np.allclose(knots, [*[0.0] * degree, *within, *[1.0] * degree], rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match=f"needs at least {degree + 1} control points, not {degree}"):
        clamped_uniform_knots(degree, degree)


def polyline_length(P, until=1.0):
    curve = evaluate(KNOTS, P, 3, np.linspace(0, until, 60_001))
    return np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()


@given(P=CONTROL_POINTS, share=st.lists(st.floats(0, 1), min_size=1, max_size=20).map(np.array))
def test_parameters_at_an_arc_length_have_that_arc_length_and_lengths_never_decrease(P, share):
    knots = clamped_uniform_knots(len(P))
    total = length(knots, P, 3)
    s = parameters_at(knots, P, 3, share * total)
    assert ((s >= 0) & (s <= 1)).all()
    assert np.allclose(lengths_until(knots, P, 3, s), share * total, rtol=0, atol=2e-3 * total)
    lengths = lengths_until(knots, P, 3, np.sort([*(2 * share - 0.5), 1.0]))
    assert (np.diff(lengths, prepend=0.0) >= 0).all()


def test_lengths_are_those_of_a_fine_polyline_and_parameters_exact_even_where_asked_and_the_ends_beyond_them():
    for until in (0.1234, 1.0):
        ours = lengths_until(KNOTS, WINDING, 3, np.array([until]))[0]
        assert ours == pytest.approx(polyline_length(WINDING, until), rel=2e-6)
    cusps = np.random.default_rng(1).normal(size=(20, 1)) * [[1.0, 2.0, 3.0]]
    assert length(KNOTS, cusps, 3) == pytest.approx(polyline_length(cusps), rel=2e-3)
    arc_lengths = np.linspace(0, length(KNOTS, WINDING, 3), 50)
    s = parameters_at(KNOTS, WINDING, 3, arc_lengths)
    assert np.allclose(lengths_until(KNOTS, WINDING, 3, s), arc_lengths, rtol=0, atol=1e-7 * arc_lengths[-1])
    assert np.allclose(parameters_at(KNOTS, WINDING, 3, np.array([-1.0, 1e6])), [0, 1], atol=1e-12)
    assert np.allclose(even_parameters(KNOTS, WINDING, 3, 50), s, atol=1e-12)


@given(data=st.data(), m=st.integers(4, 12))
@settings(max_examples=25)
def test_control_points_of_any_size_give_lengths_and_parameters_without_an_exception(data, m):
    P = data.draw(arrays(np.float64, (m, 3), elements=NUMBERS))
    knots = clamped_uniform_knots(m)
    assert not np.isnan(lengths_until(knots, P, 3, np.linspace(0, 1, 9))).any()
    even = even_parameters(knots, P, 3, 9)
    assert ((even >= 0) & (even <= 1)).all()


def test_curves_without_length_without_numbers_and_without_bounds_have_an_answer_too():
    assert length(KNOTS, np.full((20, 3), 7.0), 3) == pytest.approx(0, abs=1e-12)
    assert np.array_equal(even_parameters(KNOTS, np.zeros((20, 3)), 3, 5), np.linspace(0, 1, 5))
    assert np.isnan(length(KNOTS, np.full((20, 3), np.nan), 3))
    assert length(KNOTS, np.outer(np.tile([1e308, -1e308], 10), np.ones(3)), 3) == np.inf


def line(count, offset=0.0):
    return np.column_stack((np.linspace(0, 100, count), np.full(count, offset), np.zeros(count)))


def test_curves_are_compared_in_the_direction_that_fits_and_a_missing_part_or_a_wrong_order_shows():
    apart = curve_distance(line(500)[::-1] + np.array([0.0, 3.0, 4.0]), line(500))
    assert [apart.mean, apart.percentile_95, apart.maximum, apart.ends, apart.frechet] == pytest.approx([5.0] * 5)
    apart = curve_distance(line(1001)[:501], line(1001))
    assert (apart.maximum, apart.mean) == (pytest.approx(50.0), pytest.approx(0.5 * (0.5 * 25.0), rel=0.01))
    curve = line(300)
    shuffled = curve_distance(np.concatenate((curve[100:200], curve[:100], curve[200:])), curve)
    assert shuffled.mean == pytest.approx(0.0, abs=1e-12)
    assert shuffled.frechet > 30.0


@given(arrays(np.float64, (7, 2), elements=st.floats(-10, 10)), st.floats(0.01, 0.99))
def test_the_distance_to_a_polyline_is_that_to_the_nearest_place_on_its_pieces(points, share):
    polyline = line(8)[:, :2] + [0.0, 1.0]
    exact = np.hypot(np.clip(np.maximum(-points[:, 0], points[:, 0] - 100.0), 0, None), points[:, 1] - 1.0)
    assert distances_to_polyline(points, polyline) == pytest.approx(exact)
    between = (1 - share) * polyline[3] + share * polyline[4]
    assert distances_to_polyline(between[None], polyline)[0] == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=20)
@given(POINTS, POINTS)
def test_frechet_agrees_with_the_definition_of_eiter_and_mannila_both_ways(a, b):
    table = np.empty((len(a), len(b)))
    for i, p in enumerate(a):
        for j, q in enumerate(b):
            steps = [table[x, y] for x, y in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if x >= 0 and y >= 0]
            table[i, j] = max(np.linalg.norm(p - q), min(steps, default=0.0))
    assert discrete_frechet(a, b) == pytest.approx(table[-1, -1])
    assert discrete_frechet(b, a) == pytest.approx(table[-1, -1])
