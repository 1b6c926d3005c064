"""A curve, and what both cameras see of it: pixels, velocities, and how pixels move with the curve."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import RectifiedStereo
from shared.splines import local_basis

DEGREE = 3


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
        first, values, _ = local_basis(self.knots, DEGREE, s)
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
    first, basis, slope = local_basis(curve.knots, DEGREE, s)
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


def at_constant_speed(
    curve: Curve, s: Float64[np.ndarray, "n"], knots: Float64[np.ndarray, "k"] | None = None
) -> tuple[Curve, Float64[np.ndarray, "n"]]:
    """The curve with parameters in proportion to its length, by least squares, and where the given s lie on it."""
    target = curve.knots if knots is None else knots
    dense = np.linspace(0.0, 1.0, 12 * max(curve.spans, len(target) - 2 * DEGREE - 1) + 1)
    points = curve.at(dense)
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    along /= max(along[-1], 1e-300)
    even = np.linspace(0.0, 1.0, 5 * (len(target) - DEGREE - 1))
    wanted = curve.at(np.interp(even, along, dense))
    return Curve(target, fitted(target, even, wanted)), np.interp(s, dense, along)


def fitted(
    knots: Float64[np.ndarray, "k"], s: Float64[np.ndarray, "n"], points: Float64[np.ndarray, "n d"]
) -> Float64[np.ndarray, "m d"]:
    """Control points of the spline nearest to points that lie densely over all of its spans."""
    first, values, _ = local_basis(knots, DEGREE, s)
    basis = np.zeros((len(s), len(knots) - DEGREE - 1))
    basis[np.arange(len(s))[:, None], first[:, None] + np.arange(DEGREE + 1)] = values
    return np.linalg.solve(basis.T @ basis, basis.T @ points)
