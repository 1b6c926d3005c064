"""A curve, and what both cameras see of it: pixels, velocities, and how pixels move with the curve."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import RectifiedStereo
from shared.splines import clamped_uniform_knots, local_basis

DEGREE = 3
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

    def at(self, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3"]:
        """Points of the curve."""
        first, values, _ = basis_at(self.spans, s)
        return np.einsum("nj,njk->nk", values, self.control_points[first[:, None] + np.arange(DEGREE + 1)])

    def moved(self, step: Float64[np.ndarray, "m 3"]) -> "Curve":
        """The curve with its control points moved."""
        return Curve(self.knots, self.control_points + step)


@dataclass(frozen=True)
class View:
    """What is seen of a curve at parameters s.

    Fields:
        point_px, velocity_px: where, and its derivative by s.
        by_point: derivative of the pixel by the point of the curve.
        first, basis: the basis functions there, as in `local_basis`.
    """

    point_px: Float64[np.ndarray, "n 2"]
    velocity_px: Float64[np.ndarray, "n 2"]
    by_point: Float64[np.ndarray, "n 2 3"]
    first: Int64[np.ndarray, "n"]
    basis: Float64[np.ndarray, "n 4"]


def projected(
    curve: Curve,
    s: Float64[np.ndarray, "n"],
    eye: Int64[np.ndarray, "n"],
    camera: RectifiedStereo,
    row_offset_px: float = 0.0,
) -> View:
    """The view of each place by the eye named for it; the right image may lie some rows too low."""
    first, basis, slope = basis_at(curve.spans, s)
    near = curve.control_points[first[:, None] + np.arange(DEGREE + 1)]
    x, y, z = np.einsum("nj,njk->kn", basis, near)
    velocity = np.einsum("nj,njk->nk", slope, near)
    x = x - eye * camera.baseline
    pixel = np.column_stack(
        (camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px + row_offset_px * eye)
    )
    by_point = np.zeros((len(s), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 2] = camera.fx_px / z, -camera.fx_px * x / z**2
    by_point[:, 1, 1], by_point[:, 1, 2] = camera.fy_px / z, -camera.fy_px * y / z**2
    return View(pixel, np.einsum("nij,nj->ni", by_point, velocity), by_point, first, basis)


def basis_at(
    spans: int, s: Float64[np.ndarray, "n"]
) -> tuple[Int64[np.ndarray, "n"], Float64[np.ndarray, "n 4"], Float64[np.ndarray, "n 4"]]:
    """`local_basis` of a clamped uniform cubic, by the polynomials of its spans, and the derivatives by s."""
    place = np.clip(s, 0.0, 1.0) * spans
    first = np.minimum(place.astype(np.int64), spans - 1)
    t = place - first
    coefficients = _span_polynomials(spans)[first]
    one = np.ones_like(t)
    values = np.einsum("np,npj->nj", np.column_stack((one, t, t * t, t * t * t)), coefficients)
    slopes = np.einsum("np,npj->nj", np.column_stack((one, 2 * t, 3 * t * t)), coefficients[:, 1:])
    return first, values, slopes * spans


@lru_cache(maxsize=64)
def _span_polynomials(spans: int) -> Float64[np.ndarray, "spans 4 4"]:
    """Coefficients (power, basis function) of the basis functions on each span, over t from 0 to 1."""
    t = np.array([0.125, 0.375, 0.625, 0.875])
    knots = clamped_uniform_knots(spans + DEGREE, DEGREE)
    s = (np.arange(spans)[:, None] + t) / spans
    values = local_basis(knots, DEGREE, s.ravel())[1].reshape(spans, len(t), DEGREE + 1)
    return np.linalg.solve(np.vander(t, increasing=True)[None], values)


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
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
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
    s = even_places(spans)
    first, values, _ = basis_at(spans, s)
    basis = np.zeros((len(s), spans + DEGREE))
    basis[np.arange(len(s))[:, None], first[:, None] + np.arange(DEGREE + 1)] = values
    return np.linalg.pinv(basis)
