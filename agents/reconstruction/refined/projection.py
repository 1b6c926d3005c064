"""A curve, and what both cameras see of it: pixels, velocities, and how pixels move with the curve."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import RectifiedStereo
from shared.splines import clamped_uniform_knots, local_basis

DEGREE = 3
LEVEL = np.zeros(4)
"""Rows that are not apart: no term of the row offset, see `rows`."""
DENSE = 12
"""Chords to a span, for lengths."""


@dataclass(frozen=True)
class Curve:
    """A clamped uniform cubic B-spline in the camera frame, and the length by which numbers are scaled."""

    knots: Float64[np.ndarray, "k"]
    control_points: Float64[np.ndarray, "m 3"]

    @property
    def spans(self) -> int:
        """How many polynomials the curve is made of."""
        return len(self.control_points) - DEGREE

    @cached_property
    def size(self) -> float:
        """The radius of the control points about their mean: the natural unit of length."""
        centred = self.control_points - self.control_points.mean(axis=0)
        return float(np.linalg.norm(centred, axis=1).max())

    @cached_property
    def polynomials(self) -> Float64[np.ndarray, "4 3 spans"]:
        """Coefficients (power, axis) of each span, over t from 0 to 1."""
        near = self.control_points[np.arange(self.spans)[:, None] + np.arange(DEGREE + 1)]
        return np.ascontiguousarray((_span_polynomials(self.spans) @ near).transpose(1, 2, 0))

    def at(self, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3"]:
        """Points of the curve."""
        span, t = _span_of(self.spans, s)
        a, b, c, d = self.polynomials[:, :, span]
        return (((d * t + c) * t + b) * t + a).T

    def derivatives(
        self, s: Float64[np.ndarray, "n"]
    ) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
        """Points of the curve, and their first and second derivatives by s."""
        span, t = _span_of(self.spans, s)
        a, b, c, d = self.polynomials[:, :, span]
        point, velocity, second = ((d * t + c) * t + b) * t + a, (3.0 * d * t + 2.0 * c) * t + b, 6.0 * d * t + 2.0 * c
        return point.T, velocity.T * self.spans, second.T * self.spans**2

    def moved(self, step: Float64[np.ndarray, "m 3"]) -> "Curve":
        """The curve with its control points moved."""
        return Curve(self.knots, self.control_points + step)


@dataclass(frozen=True)
class View:
    """What is seen of a curve at parameters s.

    Fields:
        point_px, velocity_px: where, and its derivative by s.
        scale: pixels for each unit of length at that depth, along u and v.
        slope: of the line of sight, likewise.
        lean: how the row offset changes with the pixel, along u and v.
    """

    point_px: Float64[np.ndarray, "n 2"]
    velocity_px: Float64[np.ndarray, "n 2"]
    scale: Float64[np.ndarray, "2 n"]
    slope: Float64[np.ndarray, "2 n"]
    lean: Float64[np.ndarray, "2 n"] | None = None

    @cached_property
    def by_point(self) -> Float64[np.ndarray, "n 2 3"]:
        """The derivative of the pixel by the point of the curve."""
        derivative = np.zeros((len(self.point_px), 2, 3))
        derivative[:, 0, 0], derivative[:, 1, 1] = self.scale
        derivative[:, :, 2] = -(self.scale * self.slope).T
        if self.lean is not None:
            derivative[:, 1] += np.einsum("un,nua->na", self.lean, derivative)
        return derivative


def projected(
    curve: Curve,
    s: Float64[np.ndarray, "n"],
    eye: Int64[np.ndarray, "n"],
    camera: RectifiedStereo,
    row_offset_px: Float64[np.ndarray, "4"] = LEVEL,
) -> View:
    """The view of each place by the eye named for it; the right image may lie some rows lower than the left one."""
    span, t = _span_of(curve.spans, s)
    a, b, c, d = curve.polynomials[:, :, span]
    x, y, z = ((d * t + c) * t + b) * t + a
    forward = ((3.0 * d * t + 2.0 * c) * t + b) * curve.spans
    slope = np.stack(((x - eye * camera.baseline) / z, y / z))
    scale = np.array([[camera.fx_px], [camera.fy_px]]) / z
    pixel, velocity = np.empty((len(t), 2)), np.empty((len(t), 2))
    pixel[:, 0] = camera.fx_px * slope[0] + camera.cx_px
    half = eye - 0.5
    pixel[:, 1] = camera.fy_px * slope[1] + camera.cy_px + row_offset_px[0] * half
    velocity[:] = (scale * (forward[:2] - slope * forward[2])).T
    if not row_offset_px[1:].any():
        return View(pixel, velocity, scale, slope)
    terms = half[:, None] * row_terms(slope)
    pixel[:, 1] += terms[:, 1:] @ row_offset_px[1:]
    _, by_x, by_y, by_both = row_offset_px
    lean = half * np.stack(((by_x + by_both * slope[1]) / camera.fx_px, (by_y + by_both * slope[0]) / camera.fy_px))
    velocity[:, 1] += (lean * velocity.T).sum(axis=0)
    return View(pixel, velocity, scale, slope, lean)


def row_terms(slope: Float64[np.ndarray, "2 n"]) -> Float64[np.ndarray, "n 4"]:
    """What each term of a row offset is multiplied by: 1, x, y and x y, for lines of sight of these slopes."""
    return np.column_stack((np.ones(slope.shape[1]), slope[0], slope[1], slope[0] * slope[1]))


def row_offsets_px(
    point_px: Float64[np.ndarray, "n 2"], row_offset_px: Float64[np.ndarray, "4"], camera: RectifiedStereo
) -> Float64[np.ndarray, "n"]:
    """How many rows too low the right image shows what it has at these pixels."""
    slope = (point_px - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)
    return row_terms(slope.T) @ row_offset_px


def basis_at(
    spans: int, s: Float64[np.ndarray, "n"]
) -> tuple[Int64[np.ndarray, "n"], Float64[np.ndarray, "n 4"], Float64[np.ndarray, "n 4"]]:
    """`local_basis` of a clamped uniform cubic, by the polynomials of its spans, and the derivatives by s."""
    span, t = _span_of(spans, s)
    a, b, c, d = _span_polynomials(spans)[span].transpose(1, 0, 2)
    t = t[:, None]
    return span, ((d * t + c) * t + b) * t + a, ((3.0 * d * t + 2.0 * c) * t + b) * spans


def _span_of(spans: int, s: Float64[np.ndarray, "n"]) -> tuple[Int64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """The span of each parameter, and the share of it that lies before."""
    place = np.minimum(np.maximum(s, 0.0), 1.0) * spans
    span = np.minimum(place.astype(np.int64), spans - 1)
    return span, place - span


@lru_cache(maxsize=64)
def _span_polynomials(spans: int) -> Float64[np.ndarray, "spans 4 4"]:
    """Coefficients (power, basis function) of the basis functions on each span, over t from 0 to 1."""
    t = np.array([0.125, 0.375, 0.625, 0.875])
    knots = clamped_uniform_knots(spans + DEGREE, DEGREE)
    s = (np.arange(spans)[:, None] + t) / spans
    values = local_basis(knots, DEGREE, s.ravel())[1].reshape(spans, len(t), DEGREE + 1)
    return np.linalg.solve(np.vander(t, increasing=True)[None], values)


def chords(points: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "m"]:
    """The distances between neighbouring points, one fewer than points."""
    step = points[1:] - points[:-1]
    return np.sqrt(np.einsum("nd,nd->n", step, step))


def at_constant_speed(
    curve: Curve, s: Float64[np.ndarray, "n"], without: Float64[np.ndarray, "f 2"] | None = None
) -> tuple[Curve, Float64[np.ndarray, "n"]]:
    """The curve with parameters in proportion to its length, by least squares, and where the given s lie on it.

    Args:
        without: intervals of s that are cut out of it.
    """
    dense = np.linspace(0.0, 1.0, DENSE * curve.spans + 1)
    cuts = without if without is not None else np.zeros((0, 2))
    for low, high in cuts:
        dense = np.union1d(dense[(dense < low) | (dense > high)], (low, high))
    points = curve.at(dense)
    along = np.concatenate(([0.0], np.cumsum(chords(points))))
    along /= max(along[-1], 1e-300)
    places = np.interp(even_places(curve.spans), along, dense)
    wanted = curve.at(places)
    for low, high in cuts:
        # straight across
        inside = (places > low) & (places < high)
        share = ((places[inside] - low) / (high - low))[:, None]
        first, last = curve.at(np.array([low, high]))
        wanted[inside] = first + share * (last - first)
    return Curve(curve.knots, fitted(curve.spans, wanted)), np.interp(s, dense, along)


def even_places(spans: int) -> Float64[np.ndarray, "n"]:
    """Parameters, evenly spaced and dense enough to tell a spline of so many spans."""
    return np.linspace(0.0, 1.0, 5 * (spans + DEGREE))


def fitted(spans: int, points: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "m d"]:
    """Control points of the spline nearest to points at `even_places`."""
    return _fit_matrix(spans) @ points


@lru_cache(maxsize=64)
def _fit_matrix(spans: int) -> Float64[np.ndarray, "m n"]:
    return np.linalg.pinv(_design(spans, even_places(spans)))


def _design(spans: int, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n m"]:
    """The basis functions at s, one in each column."""
    first, values, _ = basis_at(spans, s)
    basis = np.zeros((len(s), spans + DEGREE))
    basis[np.arange(len(s))[:, None], first[:, None] + np.arange(DEGREE + 1)] = values
    return basis
