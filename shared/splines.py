"""Clamped uniform B-splines and their derivatives (de Boor 1978; paper, eq. 9 to 11).

    B(s) = Σ_k N_{k,d}(s) P_k,   s in [0, 1]

The derivative of a spline is a spline of degree d − 1 over the knots without the outermost two, with control points

    P'_k = d / (t_{k+d+1} − t_{k+1}) (P_{k+1} − P_k),

so every derivative is a difference matrix applied to the control points, and B'''(s) of a cubic is constant on each
knot span.
"""

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64
from scipy.interpolate import BSpline


def clamped_uniform_knots(control_points: int, degree: int = 3) -> Float64[np.ndarray, "k"]:
    """Evenly spaced knots on [0, 1] whose ends have multiplicity degree + 1.

    Raises:
        ValueError: where there are not more control points than the degree.
    """
    if control_points <= degree:
        raise ValueError(
            f"a spline of degree {degree} needs at least {degree + 1} control points, not {control_points}"
        )
    inner = np.linspace(0.0, 1.0, control_points - degree + 1)
    return np.concatenate((np.zeros(degree), inner, np.ones(degree)))


def difference_matrix(knots: Float64[np.ndarray, "k"], degree: int, order: int) -> Float64[np.ndarray, "m_o m"]:
    """The matrix that takes control points to those of the derivative of that order, (m − order, m)."""
    matrix = np.eye(len(knots) - degree - 1)
    for step in range(order):
        d = degree - step
        t = knots[step : len(knots) - step]
        spans = t[d + 1 : -1] - t[1 : -d - 1]
        # a span is empty only where a knot is repeated more than d + 1 times, which clamped knots never are
        matrix = (d / spans)[:, None] * np.diff(matrix, axis=0)
    return matrix


def basis_matrix(
    knots: Float64[np.ndarray, "k"], degree: int, s: Float64[np.ndarray, "n"], derivative: int = 0
) -> Float64[np.ndarray, "n m"]:
    """The matrix that takes control points to the curve, or to a derivative of it, at s: (n, m)."""
    values = _design_matrix(knots, degree, s, derivative).toarray()
    return values @ difference_matrix(knots, degree, derivative) if derivative else values


def evaluate(
    knots: Float64[np.ndarray, "k"],
    control_points: Float64[np.ndarray, "m d"],
    degree: int,
    s: Float64[np.ndarray, "n"],
    derivative: int = 0,
) -> Float64[np.ndarray, "n d"]:
    """Points of the curve, or of a derivative of it, at the parameters s (clipped to the knots' range)."""
    differences = difference_matrix(knots, degree, derivative) @ control_points if derivative else control_points
    first, values = _basis(knots[derivative : len(knots) - derivative], degree - derivative, s)
    points = values[0][:, None] * differences[first]
    for k in range(1, len(values)):
        points += values[k][:, None] * differences[first + k]
    return points


def _basis(
    knots: Float64[np.ndarray, "k"], degree: int, s: Float64[np.ndarray, "n"]
) -> tuple[Int64[np.ndarray, "n"], list[Float64[np.ndarray, "n"]]]:
    """The basis functions that are not zero at each s, as in `local_basis`, one by one.

    In the order of operations of SciPy's own, so to the last bit the same, without the cost of a sparse matrix: curves
    are evaluated hundreds of times for one plan.
    """
    inside = np.clip(np.asarray(s, dtype=np.float64), knots[0], knots[-1])
    span = np.clip(np.searchsorted(knots, inside, side="right") - 1, degree, len(knots) - degree - 2)
    values = [np.ones(inside.shape)]
    for d in range(1, degree + 1):
        lower, values, carried = values, [], np.zeros(inside.shape)
        for n in range(1, d + 1):
            after, before = knots[span + n], knots[span + n - d]
            share = lower[n - 1] / (after - before)
            values.append(carried + share * (after - inside))
            carried = share * (inside - before)
        values.append(carried)
    return span - degree, values


def _design_matrix(
    knots: Float64[np.ndarray, "k"], degree: int, s: Float64[np.ndarray, "n"], derivative: int
) -> scipy.sparse.csr_array:
    """The basis of the derivative's own spline, of degree d − derivative."""
    inside = np.clip(np.asarray(s, dtype=np.float64), knots[0], knots[-1])
    if not len(inside):  # which SciPy refuses
        return scipy.sparse.csr_array((0, len(knots) - degree - derivative - 1))
    return BSpline.design_matrix(inside, knots[derivative : len(knots) - derivative], degree - derivative)


def local_basis(
    knots: Float64[np.ndarray, "k"], degree: int, s: Float64[np.ndarray, "n"]
) -> tuple[Int64[np.ndarray, "n"], Float64[np.ndarray, "n d1"], Float64[np.ndarray, "n d1"]]:
    """The degree + 1 basis functions that are not zero at each s, and their derivatives (Piegl and Tiller, A2.2).

    Returns:
        The index of the first of them, so that B(s_i) = Σ_j values[i, j] P[first[i] + j]; the values; the derivatives.
    """
    count = len(knots) - degree - 1
    inside = np.clip(s, knots[0], knots[-1])
    span = np.clip(np.searchsorted(knots, inside, side="right") - 1, degree, count - 1)
    values = np.ones((len(s), 1))
    lower = values
    for d in range(1, degree + 1):
        lower = values
        left = inside[:, None] - knots[span[:, None] + np.arange(1 - d, 1)]
        right = knots[span[:, None] + np.arange(1, d + 1)] - inside[:, None]
        share = lower / (right + left)
        values = np.zeros((len(s), d + 1))
        values[:, :-1] = right * share
        values[:, 1:] += left * share
    first = span - degree
    # N'_k = d (N_{k,d-1} / (t_{k+d} - t_k) - N_{k+1,d-1} / (t_{k+d+1} - t_{k+1}))
    width = knots[span[:, None] + np.arange(1, degree + 1)] - knots[span[:, None] + np.arange(1 - degree, 1)]
    slope = degree * lower / width
    derivatives = np.zeros((len(s), degree + 1))
    derivatives[:, 1:] = slope
    derivatives[:, :-1] -= slope
    return first, values, derivatives
