"""Arc length along B-splines, by Gauss-Legendre quadrature with six points on each quarter of a knot span.

The speed ‖B'‖ is smooth within a span and only there, so that is where a quadrature rule may be trusted. Six points
to a span are the paper's choice (section III), and plenty while the speed hardly changes; a curve that nearly stops
somewhere costs them half a per cent, hence the quarters.
"""

import numpy as np
from jaxtyping import Float64

from shared.splines import evaluate

NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
CELLS_PER_SPAN = 4
REFINEMENTS = 6
"""Newton steps from within a cell: three would do wherever the curve does not stop."""


def lengths_until(
    knots: Float64[np.ndarray, "k"],
    control_points: Float64[np.ndarray, "m d"],
    degree: int,
    s: Float64[np.ndarray, "n"],
) -> Float64[np.ndarray, "n"]:
    """Arc length of the curve from its start to each parameter, in the unit of the control points.

    It never decreases with s, and is infinite where it exceeds the range of a float.
    """
    cells = _cells(knots)
    inside = np.clip(np.asarray(s, dtype=np.float64), cells[0], cells[-1])
    # Cut at every s as well: a length is then a sum of pieces, none of which can be negative.
    cuts = np.union1d(cells, inside)
    scale = float(np.abs(control_points).max(initial=0.0))
    if scale == 0:
        return np.zeros(inside.shape)
    with np.errstate(over="ignore", invalid="ignore"):
        pieces = scale * _piece_lengths(knots, control_points / scale, degree, cuts[:-1], cuts[1:])
        lengths = np.concatenate(([0.0], np.cumsum(pieces)))
    return lengths[np.searchsorted(cuts, inside)]


def length(knots: Float64[np.ndarray, "k"], control_points: Float64[np.ndarray, "m d"], degree: int) -> float:
    """Arc length of the whole curve."""
    return float(lengths_until(knots, control_points, degree, knots[-1:])[0])


def even_parameters(
    knots: Float64[np.ndarray, "k"], control_points: Float64[np.ndarray, "m d"], degree: int, count: int
) -> Float64[np.ndarray, "n"]:
    """Parameters of `count` points that are evenly spaced along the curve, both ends included.

    Evenly spaced parameters where the curve has no length, or none that is finite.
    """
    total = length(knots, control_points, degree)
    if not 0 < total < np.inf:
        return np.linspace(knots[0], knots[-1], count)
    return parameters_at(knots, control_points, degree, np.linspace(0.0, total, count))


def parameters_at(
    knots: Float64[np.ndarray, "k"],
    control_points: Float64[np.ndarray, "m d"],
    degree: int,
    arc_lengths: Float64[np.ndarray, "n"],
) -> Float64[np.ndarray, "n"]:
    """The parameters at which the curve has these arc lengths: a table's guess, then Newton within a bracket.

    An arc length before the start or beyond the end gives that end.
    """
    scale = float(np.abs(control_points).max(initial=0.0)) or 1.0
    control_points, arc_lengths = control_points / scale, arc_lengths / scale
    table = _cells(knots)
    lengths = lengths_until(knots, control_points, degree, table)
    cell = np.clip(np.searchsorted(lengths, arc_lengths, side="right") - 1, 0, len(table) - 2)
    start, before = table[cell], lengths[cell]
    low, high = start, table[cell + 1]
    s = np.interp(arc_lengths, lengths, table)
    for _ in range(REFINEMENTS):
        pieces, speed = _pieces_and_speed(knots, control_points, degree, start, s)
        excess = before + pieces - arc_lengths
        low, high = np.where(excess < 0, s, low), np.where(excess > 0, s, high)
        step = np.divide(excess, speed, out=np.zeros_like(s), where=speed > 0)
        bracketed = (s - step >= low) & (s - step <= high)
        s = np.where(bracketed, s - step, 0.5 * (low + high))
    return s


def _cells(knots: Float64[np.ndarray, "k"]) -> Float64[np.ndarray, "c"]:
    """The knots, and what cuts each span between them into equal cells."""
    breaks = np.unique(knots)
    return np.interp(np.arange(CELLS_PER_SPAN * (len(breaks) - 1) + 1) / CELLS_PER_SPAN, np.arange(len(breaks)), breaks)


def _piece_lengths(
    knots: Float64[np.ndarray, "k"],
    control_points: Float64[np.ndarray, "m d"],
    degree: int,
    start: Float64[np.ndarray, "n"],
    end: Float64[np.ndarray, "n"],
) -> Float64[np.ndarray, "n"]:
    return _pieces_and_speed(knots, control_points, degree, start, end)[0]


def _pieces_and_speed(
    knots: Float64[np.ndarray, "k"],
    control_points: Float64[np.ndarray, "m d"],
    degree: int,
    start: Float64[np.ndarray, "n"],
    end: Float64[np.ndarray, "n"],
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """The lengths of pieces, and the speed at their ends, of one evaluation of the curve."""
    half = 0.5 * (end - start)
    s = (0.5 * (end + start))[:, None] + half[:, None] * NODES
    velocity = evaluate(knots, control_points, degree, np.concatenate((s.ravel(), end)), 1)
    speed = np.linalg.norm(velocity, axis=1)
    return half * (speed[: s.size].reshape(s.shape) @ WEIGHTS), speed[s.size :]
