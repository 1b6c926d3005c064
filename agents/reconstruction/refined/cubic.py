"""Clamped uniform cubic B-splines by the polynomials of their spans, over t from 0 to 1 on each."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from jaxtyping import Float64, Int64

from shared.splines import clamped_uniform_knots, local_basis

KEPT = 64
"""Of each, for so many arguments."""

_Given = ParamSpec("_Given")
_Array = TypeVar("_Array", bound="np.ndarray[Any, Any]")


def kept(compute: Callable[_Given, _Array]) -> Callable[_Given, _Array]:
    """The same function, computed once for each argument; what was written into it all later frames would get."""

    @functools.wraps(compute)
    def once(*given: _Given.args, **named: _Given.kwargs) -> _Array:
        array = compute(*given, **named)
        array.setflags(write=False)
        return array

    return cast(Callable[_Given, _Array], functools.lru_cache(KEPT)(once))


DEGREE = 3


def basis_at(
    spans: int, s: Float64[np.ndarray, "n"]
) -> tuple[Int64[np.ndarray, "n"], Float64[np.ndarray, "n 4"], Float64[np.ndarray, "n 4"]]:
    """`local_basis` of a clamped uniform cubic, by the polynomials of its spans, and the derivatives by s."""
    span, t = span_of(spans, s)
    value, slope = with_slopes(_powers_of_basis(spans).take(span, axis=2), t)
    slope *= spans
    return span, value.T, slope.T


def with_slopes(
    powers: Float64[np.ndarray, "4 k n"], t: Float64[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "k n"], Float64[np.ndarray, "k n"]]:
    """Values of cubics and their derivatives by t, from their coefficients by power."""
    a, b, c, d = powers
    # in place: fresh memory takes as long as the arithmetic
    value = d * t
    slope = value.copy()
    value += c
    slope += value
    value *= t
    value += b
    slope *= t
    slope += value
    value *= t
    value += a
    return value, slope


def span_of(spans: int, s: Float64[np.ndarray, "n"]) -> tuple[Int64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """The span of each parameter, and the share of it that lies before."""
    place = np.minimum(np.maximum(s, 0.0), 1.0) * spans
    span = np.minimum(place.astype(np.int64), spans - 1)
    return span, place - span


@kept
def span_polynomials(spans: int) -> Float64[np.ndarray, "spans 4 4"]:
    """Coefficients (power, basis function) of the basis functions on each span, over t from 0 to 1."""
    t = np.array([0.125, 0.375, 0.625, 0.875])
    knots = clamped_uniform_knots(spans + DEGREE, DEGREE)
    s = (np.arange(spans)[:, None] + t) / spans
    values = local_basis(knots, DEGREE, s.ravel())[1].reshape(spans, len(t), DEGREE + 1)
    return np.linalg.solve(np.vander(t, increasing=True)[None], values)


@kept
def _powers_of_basis(spans: int) -> Float64[np.ndarray, "4 4 spans"]:
    """The same in the order (power, basis function, span)."""
    return np.ascontiguousarray(span_polynomials(spans).transpose(1, 2, 0))


@kept
def even_parameters(spans: int, per_span: int) -> Float64[np.ndarray, "n"]:
    """Parameters that cut each span into so many parts, both ends of the curve included."""
    return np.linspace(0.0, 1.0, per_span * spans + 1)


@kept
def even_powers(per_span: int, derivative: int) -> Float64[np.ndarray, "4 n"]:
    """Powers of t, or their first derivatives, at even places of a span, its end included."""
    t, power = np.linspace(0.0, 1.0, per_span + 1), np.arange(DEGREE + 1)[:, None]
    return t**power if not derivative else power * t ** np.maximum(power - 1, 0)


@kept
def even_places(spans: int) -> Float64[np.ndarray, "n"]:
    """Parameters, evenly spaced and dense enough to tell a spline of so many spans."""
    return np.linspace(0.0, 1.0, 5 * (spans + DEGREE))


def fitted(spans: int, points: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "m d"]:
    """Control points of the spline nearest to points at `even_places`."""
    return _fit_matrix(spans) @ points


@kept
def _fit_matrix(spans: int) -> Float64[np.ndarray, "m n"]:
    return np.linalg.pinv(_design(spans, even_places(spans)))


def _design(spans: int, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n m"]:
    """The basis functions at s, one in each column."""
    first, values, _ = basis_at(spans, s)
    basis = np.zeros((len(s), spans + DEGREE))
    basis[np.arange(len(s))[:, None], first[:, None] + np.arange(DEGREE + 1)] = values
    return basis
