import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from shared.splines import basis_matrix, clamped_uniform_knots, difference_matrix, evaluate

SIZES = ((4, 3), (5, 3), (20, 3), (22, 3), (6, 5), (3, 2), (9, 1))


def random_spline(seed, control_points=20, degree=3):
    return clamped_uniform_knots(control_points, degree), np.random.default_rng(seed).normal(size=(control_points, 3))


@pytest.mark.parametrize(("control_points", "degree"), SIZES)
def test_knots_are_evenly_spaced_between_ends_that_are_repeated_degree_plus_one_times(control_points, degree):
    knots = clamped_uniform_knots(control_points, degree)
    assert len(knots) == control_points + degree + 1
    assert (knots[: degree + 1] == 0).all()
    assert (knots[-degree - 1 :] == 1).all()
    spans = np.diff(knots[degree:-degree])
    assert np.allclose(spans, 1 / (control_points - degree), rtol=1e-12)


def test_too_few_control_points_are_refused_with_the_number_that_is_needed():
    with pytest.raises(ValueError, match="needs at least 4 control points, not 3"):
        clamped_uniform_knots(3)


@settings(max_examples=20)
@given(
    size=st.sampled_from(SIZES),
    seed=st.integers(0, 999),
    s=st.lists(st.floats(0, 1), min_size=1, max_size=20).map(np.array),
    data=st.data(),
)
def test_curve_and_derivatives_are_those_of_scipy(size, seed, s, data):
    control_points, degree = size
    derivative = data.draw(st.integers(0, degree))
    knots, P = random_spline(seed, control_points, degree)
    theirs = BSpline(knots, P, degree).derivative(derivative)(s) if derivative else BSpline(knots, P, degree)(s)
    scale = np.abs(difference_matrix(knots, degree, derivative)).sum(axis=1).max()
    assert np.allclose(evaluate(knots, P, degree, s, derivative), theirs, rtol=0, atol=1e-12 * scale)
    assert np.allclose(basis_matrix(knots, degree, s, derivative) @ P, theirs, rtol=0, atol=1e-12 * scale)


@settings(max_examples=10)
@given(size=st.sampled_from(SIZES), s=st.lists(st.floats(0, 1), min_size=1, max_size=20).map(np.array))
def test_basis_is_a_partition_of_unity_without_negative_parts(size, s):
    control_points, degree = size
    basis = basis_matrix(clamped_uniform_knots(control_points, degree), degree, s)
    assert basis.shape == (len(s), control_points)
    assert basis.min() >= 0
    assert np.allclose(basis.sum(axis=1), 1, rtol=1e-14)
    assert (np.count_nonzero(basis, axis=1) <= degree + 1).all()


def test_third_derivative_is_constant_on_each_span_and_has_its_difference_matrix_for_values():
    knots, P = random_spline(2)
    spans = 17
    inside = (np.arange(spans)[:, None] + [0.01, 0.5, 0.99]) / spans
    third = evaluate(knots, P, 3, inside.ravel(), 3).reshape(spans, 3, 3)
    assert np.array_equal(third[:, 0], third[:, 1])
    assert np.array_equal(third[:, 0], third[:, 2])
    assert np.allclose(third[:, 0], difference_matrix(knots, 3, 3) @ P, rtol=1e-12)


def test_parameters_beyond_the_ends_give_the_ends_and_no_parameters_no_points():
    knots, P = random_spline(4)
    assert np.array_equal(evaluate(knots, P, 3, np.array([-0.5, 1.5])), evaluate(knots, P, 3, np.array([0.0, 1.0])))
    for derivative in range(4):
        assert evaluate(knots, P, 3, np.zeros(0), derivative).shape == (0, 3)
        assert basis_matrix(knots, 3, np.zeros(0), derivative).shape == (0, 20)
