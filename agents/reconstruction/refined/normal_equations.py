"""Gauss-Newton's equations of a spline, in blocks of one knot span each.

What depends on one place of the curve depends on the four control points of its span, so the matrix is a sum of blocks
of 12 x 12 along the diagonal, a band of 11 below it, and everything is solved in time proportional to the curve.

With π_e the projection into image e, x_i a point of its centreline, n_i the normal of the projected curve at s_i and
σ_i the deviation of x_i, the residuals are r_i(P) = n_iᵀ (π_e(B(s_i)) − x_i) / σ_i. At the thread's ends the distance
along the curve counts as well. Elsewhere nothing says where along itself the curve has its parameters, so motion along
itself is damped; that changes no solution, since it holds back steps and not places.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import lapack

from agents.reconstruction.refined.projection import DEGREE, Curve, basis_at, kept, projected, row_terms
from agents.reconstruction.refined.sightings import Sightings
from schemas.messages import RectifiedStereo
from shared.splines import clamped_uniform_knots, difference_matrix

SIDE = 3 * (DEGREE + 1)
TRIANGLE = np.tril_indices(SIDE)
END_DEVIATION_PX = 0.7
BENDING = 0.01
"""Share of bending itself in the roughness, for knot spans of length 1: a free end of thread is straight, and where
nothing is seen a thread takes no detour."""
DAMPING = 0.3
"""Of the length of a knot span: how far one step may carry the curve along itself at the cost of one deviation."""


@dataclass(frozen=True)
class Rows:
    """Linearised residuals: r + g · δB(s), one for each sighting and one more for each end.

    Fields:
        first, basis: where each acts, as in `local_basis`.
        gradient: (n, 3), by the point of the curve.
        lever, slope: by the row of the right image, and of the line of sight (see `View`).
        sightings: how many of them are distances across the thread, the first ones.
    """

    residual: Float64[np.ndarray, "n"]
    gradient: Float64[np.ndarray, "n 3"]
    lever: Float64[np.ndarray, "n"]
    slope: Float64[np.ndarray, "2 n"]
    first: Int64[np.ndarray, "n"]
    basis: Float64[np.ndarray, "n 4"]
    sightings: int

    @cached_property
    def by_row_offset(self) -> Float64[np.ndarray, "n 4"]:
        """By each term of an offset of the right image's rows."""
        return self.lever[:, None] * row_terms(self.slope)


@dataclass(frozen=True)
class Blocks:
    """A quadratic function of the control points' motion δ: ½ δᵀHδ + gᵀδ, by knot spans."""

    H: Float64[np.ndarray, "spans 12 12"]
    g: Float64[np.ndarray, "spans 12"]

    def __add__(self, other: "Blocks") -> "Blocks":
        return Blocks(self.H + other.H, self.g + other.g)

    def __mul__(self, factor: float) -> "Blocks":
        return Blocks(self.H * factor, self.g * factor)


def linearised(
    curve: Curve, sight: Sightings, camera: RectifiedStereo, row_offset_px: Float64[np.ndarray, "4"]
) -> Rows:
    """Residuals and their derivatives at this curve."""
    end, count = np.flatnonzero(sight.is_end), len(sight.s)
    which = np.concatenate((np.arange(count), end))
    s, eye = sight.s[which], sight.eye[which]
    view = projected(curve, s, eye, camera, row_offset_px)
    first, basis, _ = basis_at(curve.spans, s)
    u, v = view.velocity_px.T
    # across the curve, and along it at the ends
    direction = np.hstack(((-v[:count], u[:count]), (u[count:], v[count:])))
    # in deviations, as all that follows from it
    deviation = np.concatenate((sight.deviation_px, np.full(len(end), END_DEVIATION_PX)))
    direction /= np.maximum(np.sqrt(u * u + v * v), 1e-12) * deviation
    off = (view.point_px - sight.point_px[which]).T
    return Rows(
        residual=np.einsum("in,in->n", direction, off),
        gradient=view.by_point(direction),
        lever=direction[1] * (eye - 0.5),
        slope=view.slope,
        first=first,
        basis=basis,
        sightings=count,
    )


def data_blocks(rows: Rows, weight: Float64[np.ndarray, "n"], spans: int) -> Blocks:
    """The blocks of the weighted sum of squares of residuals; weights are not negative."""
    n = len(rows.residual)
    both = np.empty((SIDE + 1, n))
    np.multiply(rows.basis.T[:, None], rows.gradient.T, out=both[:SIDE].reshape(DEGREE + 1, 3, n))
    both[SIDE] = rows.residual
    both *= np.sqrt(weight)
    stacked = _stacked(rows.first, both.T, spans)
    squares = stacked.transpose(0, 2, 1) @ stacked
    return Blocks(squares[:, :SIDE, :SIDE], squares[:, :SIDE, SIDE])


def row_offset_columns(rows: Rows, weight: Float64[np.ndarray, "n"], spans: int) -> Float64[np.ndarray, "spans 12 4"]:
    """Mixed derivatives by the control points and the terms of the row offset."""
    design = (rows.basis[:, :, None] * rows.gradient[:, None, :]).reshape(-1, SIDE)
    return _by_span(rows.first, design[:, :, None] * (weight[:, None] * rows.by_row_offset)[:, None, :], spans)


def damping_blocks(curve: Curve) -> Blocks:
    """What holds the curve back along itself."""
    spans = curve.spans
    basis, slope = _two_places(spans)
    velocity = slope @ curve.near
    speed = np.maximum(np.sqrt(np.einsum("kpa,kpa->kp", velocity, velocity)), 1e-12)[:, :, None]
    tangent = velocity / speed * (spans / (DAMPING * speed.mean()))
    design = (basis[:, :, :, None] * tangent[:, :, None, :]).reshape(spans, 2, SIDE)
    return Blocks(design.transpose(0, 2, 1) @ design, np.zeros((spans, SIDE)))


@kept
def _two_places(spans: int) -> Float64[np.ndarray, "2 spans 2 4"]:
    """The basis functions, and their derivatives, a quarter from either end of each span."""
    _, basis, slope = basis_at(spans, (np.arange(2 * spans) + 0.5) / (2 * spans))
    return np.stack((basis, slope)).reshape(2, spans, 2, DEGREE + 1)


def roughness_blocks(curve: Curve, weight: Float64[np.ndarray, "spans"]) -> Blocks:
    """½ Σ_k w_k ‖Δ³P_k / size‖², the minimum-variation objective by spans, with knot spans of length 1.

    In each block the rows of one span's third difference, a matrix of rank 3.
    """
    scaled, form = weight / curve.size**2, _roughness_form(curve.spans, BENDING)
    g = ((scaled[:, None, None] * form) @ curve.near).reshape(-1, SIDE)
    return Blocks(scaled[:, None, None] * _roughness(curve.spans, BENDING), g)


@kept
def _roughness(spans: int, bending: float) -> Float64[np.ndarray, "spans 12 12"]:
    return np.einsum("kij,ab->kiajb", _roughness_form(spans, bending), np.eye(3)).reshape(-1, SIDE, SIDE)


@kept
def _roughness_form(spans: int, bending: float) -> Float64[np.ndarray, "spans 4 4"]:
    """Of each direction in space by itself."""
    third = third_differences(spans)
    local = np.stack([third[k, k : k + DEGREE + 1] for k in range(spans)])
    # the second derivative is linear on a span: at its two ends
    second = difference_matrix(clamped_uniform_knots(spans + DEGREE, DEGREE), DEGREE, 2) / spans**2
    ends = np.stack([second[k : k + 2, k : k + DEGREE + 1] for k in range(spans)])
    return np.einsum("ki,kj->kij", local, local) + 0.5 * bending * np.einsum("kei,kej->kij", ends, ends)


@kept
def third_differences(spans: int) -> Float64[np.ndarray, "spans m"]:
    """The third derivative on each span, for spans of length 1, from the control points."""
    return difference_matrix(clamped_uniform_knots(spans + DEGREE, DEGREE), DEGREE, 3) / spans**3


def gradient(by_span: Float64[np.ndarray, "spans 12 *k"]) -> Float64[np.ndarray, "v *k"]:
    """The vector over all control points (interleaved) of what is given by spans; of several, one in each column."""
    spans = len(by_span)
    if by_span.ndim == 3:
        return np.column_stack([gradient(column) for column in by_span.transpose(2, 0, 1)])
    return np.bincount(_vector_index(spans), by_span.ravel(), minlength=3 * (spans + DEGREE))


@kept
def _vector_index(spans: int) -> Int64[np.ndarray, "k"]:
    """Where the entries of all spans belong in the vector."""
    return (3 * np.arange(spans)[:, None] + np.arange(SIDE)).ravel()


def band(blocks: Blocks) -> Float64[np.ndarray, "12 v"]:
    """H in LAPACK's lower band form."""
    spans = len(blocks.H)
    size = 3 * (spans + DEGREE)
    lower = blocks.H[:, TRIANGLE[0], TRIANGLE[1]]
    return np.bincount(_band_index(spans), lower.ravel(), minlength=SIDE * size).reshape(SIDE, size)


@kept
def _band_index(spans: int) -> Int64[np.ndarray, "k"]:
    """Where the lower triangles of the blocks belong in the band."""
    i, j = TRIANGLE
    return ((i - j) * 3 * (spans + DEGREE) + 3 * np.arange(spans)[:, None] + j).ravel()


def factored(blocks: Blocks) -> Float64[np.ndarray, "12 v"]:
    """Cholesky's factor of H, in band form.

    Raises:
        numpy.linalg.LinAlgError: where H is not positive definite.
    """
    return factored_band(band(blocks))


def factored_band(lower: Float64[np.ndarray, "12 v"]) -> Float64[np.ndarray, "12 v"]:
    """Cholesky's factor of a matrix in band form.

    Raises:
        numpy.linalg.LinAlgError: where it is not positive definite.
    """
    # LAPACK itself: checks and conversions take longer than the factorisation of a matrix this small
    factor, info = lapack.dpbtrf(lower, lower=1)
    if info:
        raise np.linalg.LinAlgError(f"the leading minor of order {info} is not positive definite")
    return factor


def solved(factor: Float64[np.ndarray, "12 v"], right: Float64[np.ndarray, "v *k"]) -> Float64[np.ndarray, "v *k"]:
    """H⁻¹ times a vector or matrix."""
    return lapack.dpbtrs(factor, right, lower=1)[0]


def finite(numbers: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
    """The same numbers.

    Raises:
        numpy.linalg.LinAlgError: where one is none.
    """
    if not np.isfinite(numbers).all():
        raise np.linalg.LinAlgError("what solves the equations is no number")
    return numbers


def _stacked(
    first: Int64[np.ndarray, "n"], values: Float64[np.ndarray, "n k"], spans: int
) -> Float64[np.ndarray, "spans most k"]:
    """The rows of each span below each other, and zeros below those."""
    order = np.argsort(first, kind="stable")
    count = np.bincount(first, minlength=spans)
    most = int(count.max(initial=0))
    place = np.empty(len(first), np.int64)
    place[order] = np.arange(len(first))
    place += (np.arange(spans) * most - np.cumsum(count) + count)[first]
    stacked = np.zeros((spans * most, values.shape[1]))
    stacked[place] = values
    return stacked.reshape(spans, most, -1)


def _by_span(
    first: Int64[np.ndarray, "n"], values: Float64[np.ndarray, "n *k"], spans: int
) -> Float64[np.ndarray, "spans *k"]:
    """Sums over what acts on the same span."""
    total = np.zeros((spans, *values.shape[1:]))
    order = np.argsort(first, kind="stable")
    where, start = np.unique(first[order], return_index=True)
    total[where] = np.add.reduceat(values[order], start, axis=0)
    return total
