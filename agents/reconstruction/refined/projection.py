"""A curve, and what both cameras see of it: pixels, velocities, and how pixels move with the curve.

Clamped uniform cubic B-splines by the polynomials of their spans, over t from 0 to 1 on each.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import RectifiedStereo
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
    linear = d * t + c
    square = linear * t + b
    return square * t + a, (d * t + linear) * t + square


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
    return np.linalg.pinv(design_matrix(spans, even_places(spans)))


def design_matrix(spans: int, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n m"]:
    """The basis functions at s, one in each column."""
    first, values, _ = basis_at(spans, s)
    basis = np.zeros((len(s), spans + DEGREE))
    basis[np.arange(len(s))[:, None], first[:, None] + np.arange(DEGREE + 1)] = values
    return basis


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
        return np.ascontiguousarray((span_polynomials(self.spans) @ self.near).transpose(1, 2, 0))

    @cached_property
    def near(self) -> Float64[np.ndarray, "spans 4 3"]:
        """The control points on which each span depends."""
        return self.control_points[np.arange(self.spans)[:, None] + np.arange(DEGREE + 1)]

    def at(self, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3"]:
        """Points of the curve."""
        span, t = span_of(self.spans, s)
        a, b, c, d = self.polynomials.take(span, axis=2)
        return (((d * t + c) * t + b) * t + a).T

    def evenly(self, per_span: int, derivative: int = 0) -> Float64[np.ndarray, "n 3"]:
        """Points of the curve at `even_parameters`, or first derivatives by s there, as one product of matrices."""
        if (per_span, derivative) not in self._evenly:
            self._evenly[per_span, derivative] = self._at_even_places(per_span, derivative)
        return self._evenly[per_span, derivative]

    @cached_property
    def _evenly(self) -> dict[tuple[int, int], Float64[np.ndarray, "n 3"]]:
        """Those that were asked for: both eyes look at the same places."""
        return {}

    def _at_even_places(self, per_span: int, derivative: int) -> Float64[np.ndarray, "n 3"]:
        powers = even_powers(per_span, derivative)
        along = np.empty((3, self.spans * per_span + 1))
        along[:, :-1] = (self.polynomials.reshape(DEGREE + 1, -1).T @ powers[:, :-1]).reshape(3, -1)
        along[:, -1] = powers[:, -1] @ self.polynomials[:, :, -1]
        along *= self.spans**derivative
        along.setflags(write=False)
        return along.T

    def with_velocities(
        self, s: Float64[np.ndarray, "n"]
    ) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
        """Points of the curve, and their derivatives by s."""
        span, t = span_of(self.spans, s)
        point, velocity = with_slopes(self.polynomials.take(span, axis=2), t)
        velocity *= self.spans
        return point.T, velocity.T

    def derivatives(
        self, s: Float64[np.ndarray, "n"]
    ) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
        """Points of the curve, and their first and second derivatives by s."""
        span, t = span_of(self.spans, s)
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

    def by_point(self, direction: Float64[np.ndarray, "2 n"]) -> Float64[np.ndarray, "n 3"]:
        """The derivative by the point of the curve of how far the pixel lies along a direction, (u, v)."""
        u, v = direction
        if self.lean is not None:
            u, v = u + v * self.lean[0], v * (1.0 + self.lean[1])
        by_x, by_y = u * self.scale[0], v * self.scale[1]
        return np.stack((by_x, by_y, -(by_x * self.slope[0] + by_y * self.slope[1]))).T


def projected(
    curve: Curve,
    s: Float64[np.ndarray, "n"],
    eye: Int64[np.ndarray, "n"],
    camera: RectifiedStereo,
    row_offset_px: Float64[np.ndarray, "4"] = LEVEL,
) -> View:
    """The view of each place by the eye named for it; the right image may lie some rows lower than the left one."""
    return _view(*curve.with_velocities(s), eye, camera, row_offset_px)


def pixels_evenly(
    curve: Curve,
    per_span: int,
    eye: int,
    camera: RectifiedStereo,
    row_offset_px: Float64[np.ndarray, "4"] = LEVEL,
) -> Float64[np.ndarray, "n 2"]:
    """Where one eye sees the places at `even_parameters`."""
    return _seen(curve.evenly(per_span), eye, camera, row_offset_px)[0].T


def projected_evenly(
    curve: Curve, per_span: int, camera: RectifiedStereo, row_offset_px: Float64[np.ndarray, "4"] = LEVEL
) -> View:
    """The views of the places at `even_parameters` by the left eye, and then by the right one."""
    point, velocity = (np.tile(curve.evenly(per_span, k).T, 2).T for k in (0, 1))
    return _view(point, velocity, np.repeat((0, 1), len(point) // 2), camera, row_offset_px)


def _seen(
    point: Float64[np.ndarray, "n 3"],
    eye: Int64[np.ndarray, "n"] | int,
    camera: RectifiedStereo,
    row_offset_px: Float64[np.ndarray, "4"],
) -> tuple[Float64[np.ndarray, "2 n"], Float64[np.ndarray, "2 n"]]:
    """Pixels, and slopes of the lines of sight."""
    x, y, z = point.T
    slope = np.stack((x - eye * camera.baseline, y)) / z
    pixel = np.array([[camera.fx_px], [camera.fy_px]]) * slope + ((camera.cx_px,), (camera.cy_px,))
    half = eye - 0.5
    pixel[1] += row_offset_px[0] * half
    if row_offset_px[1:].any():
        pixel[1] += half * (row_terms(slope)[:, 1:] @ row_offset_px[1:])
    return pixel, slope


def _view(
    point: Float64[np.ndarray, "n 3"],
    forward: Float64[np.ndarray, "n 3"],
    eye: Int64[np.ndarray, "n"] | int,
    camera: RectifiedStereo,
    row_offset_px: Float64[np.ndarray, "4"],
) -> View:
    pixel, slope = _seen(point, eye, camera, row_offset_px)
    scale = np.array([[camera.fx_px], [camera.fy_px]]) / point[:, 2]
    velocity = (forward[:, :2].T - slope * forward[:, 2]) * scale
    if not row_offset_px[1:].any():
        return View(pixel.T, velocity.T, scale, slope)
    _, by_x, by_y, by_both = row_offset_px
    lean = np.stack(((by_x + by_both * slope[1]) / camera.fx_px, (by_y + by_both * slope[0]) / camera.fy_px))
    lean *= eye - 0.5
    velocity[1] += (lean * velocity).sum(axis=0)
    return View(pixel.T, velocity.T, scale, slope, lean)


def row_terms(slope: Float64[np.ndarray, "2 n"]) -> Float64[np.ndarray, "n 4"]:
    """What each term of a row offset is multiplied by: 1, x, y and x y, for lines of sight of these slopes."""
    return np.column_stack((np.ones(slope.shape[1]), slope[0], slope[1], slope[0] * slope[1]))


def row_offsets_px(
    point_px: Float64[np.ndarray, "n 2"], row_offset_px: Float64[np.ndarray, "4"], camera: RectifiedStereo
) -> Float64[np.ndarray, "n"]:
    """How many rows too low the right image shows what it has at these pixels."""
    slope = (point_px - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)
    return row_terms(slope.T) @ row_offset_px


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
    dense = even_parameters(curve.spans, DENSE)
    cuts = without if without is not None else np.zeros((0, 2))
    for low, high in cuts:
        dense = np.union1d(dense[(dense < low) | (dense > high)], (low, high))
    points = curve.at(dense) if len(cuts) else curve.evenly(DENSE)
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
