"""Rest states of a thread as an elastic rod: clamped where it leaves the tissue or is held, lying on what is below.

A rod that does not stretch is a chain of edges of length h with unit tangents t. Its energy over its stiffness B,

    E / B = Σ |t_{i+1} − t_i − κ h (ẑ × t_i)|² / 2h  −  (w / B) h Σ z  +  penalties for contact and for its held end,

is least at rest (Bergou et al. 2008, Discrete elastic rods, without twist, which a braid hardly resists). κ is the
curvature that it keeps from its packet, and w its weight, which pulls along +z, away from the camera.
Lengths in mm, points in the left camera's frame.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.optimize import minimize

from shared.scene.path_traced.ground import grid_axes
from shared.scene.surface import Surface

CONTACT, HOLD = 0.2, 2.0
"""Stiffness of contact and of the held end, over B, in mm⁻⁴ and mm⁻³: tissue yields by hundredths of a millimetre."""

STRIDE = 4
NEIGHBOURS = 8
ITERATIONS = 3000
FINE = 1200


@dataclass(frozen=True)
class Rod:
    """Edge length, radius, the cube root of B / w (how long a piece bears its own weight), and the curvature kept."""

    edge_mm: float
    radius_mm: float
    bearing_length_mm: float
    kept_curvature: float = 0.0


@dataclass(frozen=True)
class Held:
    """How its ends are held: the first point and direction; the last ones, or None for an end that lies free.

    So many points at either end are within the tissue and not pushed out of it.
    """

    start: Float64[np.ndarray, "3"]
    start_direction: Float64[np.ndarray, "3"]
    end: Float64[np.ndarray, "3"] | None = None
    end_direction: Float64[np.ndarray, "3"] | None = None
    buried: tuple[int, int] = (0, 0)


class Bed:
    """A surface for contact: smooth enough that the energy has a gradient everywhere."""

    def __init__(self, surface: Surface) -> None:
        x, y = grid_axes(surface)
        depth = surface.depth_mm[::STRIDE, ::STRIDE].astype(np.float64)
        self._spline = RectBivariateSpline(y[::STRIDE].astype(np.float64), x[::STRIDE].astype(np.float64), depth)

    def depth(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
        """Depth of the surface beneath points."""
        return np.asarray(self._spline.ev(points[:, 1], points[:, 0]))

    def slopes(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """∂depth/∂x and ∂depth/∂y beneath points."""
        y, x = points[:, 1], points[:, 0]
        return np.column_stack((self._spline.ev(y, x, dy=1), self._spline.ev(y, x, dx=1)))


def rest_state(
    rod: Rod, held: Held, tangents: Float64[np.ndarray, "n 3"], bed: Bed | None
) -> Float64[np.ndarray, "n1 3"]:
    """The points of the rod at rest, found downhill from tangents at which it is let go.

    Without a bed it hangs in the air.
    """
    found = minimize(
        _energy,
        tangents.ravel(),
        args=(rod, held, bed),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": ITERATIONS, "maxfun": 2 * ITERATIONS, "maxcor": 30, "ftol": 1e-14, "gtol": 1e-9},
    )
    return _points(rod, held, _unit(np.asarray(found.x).reshape(-1, 3)))


def smooth_line(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m 3"]:
    """A fine polyline without corners through the points of a rod."""
    place = np.linspace(0.0, 1.0, len(points))
    return np.asarray(CubicSpline(place, points)(np.linspace(0.0, 1.0, FINE)))


def _energy(flat: Float64[np.ndarray, "k"], rod: Rod, held: Held, bed: Bed | None) -> tuple[float, np.ndarray]:
    free = flat.reshape(-1, 3)
    t = _unit(free)
    bending, by_tangent = _bending(t, rod, held)
    points = _points(rod, held, t)
    other, by_point = _outside(points, rod, held, bed)
    # a point moves with all edges before it
    by_tangent += rod.edge_mm * np.cumsum(by_point[:0:-1], axis=0)[::-1]
    length = np.linalg.norm(free, axis=1, keepdims=True)
    across = by_tangent - np.einsum("ij,ij->i", by_tangent, t)[:, None] * t
    # lengths of the free vectors mean nothing; a weak pull keeps them near one
    pull = 1e-3 * (length - 1.0)
    return bending + other + 500.0 * float((pull**2).sum()), (across / length + pull * t).ravel()


def _bending(t: np.ndarray, rod: Rod, held: Held) -> tuple[float, np.ndarray]:
    chain = [held.start_direction[None], t]
    if held.end_direction is not None:
        chain.append(held.end_direction[None])
    ends = np.vstack(chain)
    turn = rod.kept_curvature * rod.edge_mm
    bend = np.diff(ends, axis=0) - turn * _turned(ends[:-1])
    force = bend / rod.edge_mm
    # the transpose of ẑ × is −ẑ ×
    gradient = np.zeros_like(ends)
    gradient[1:] += force
    gradient[:-1] += -force + turn * _turned(force)
    return 0.5 * float((bend**2).sum()) / rod.edge_mm, gradient[1 : len(t) + 1]


def _outside(points: np.ndarray, rod: Rod, held: Held, bed: Bed | None) -> tuple[float, np.ndarray]:
    """Weight, contact with the bed and with itself, and the held end: energy and its gradient by the points."""
    weight = rod.edge_mm / rod.bearing_length_mm**3
    energy = -weight * float(points[:, 2].sum())
    gradient = np.zeros_like(points)
    gradient[:, 2] -= weight
    if bed is not None:
        deep = np.maximum(points[:, 2] + rod.radius_mm - bed.depth(points), 0.0)
        deep[: held.buried[0]] = 0.0
        deep[len(deep) - held.buried[1] :] = 0.0
        energy += 0.5 * CONTACT * rod.edge_mm * float((deep**2).sum())
        push = CONTACT * rod.edge_mm * deep
        gradient[:, 2] += push
        gradient[:, :2] -= push[:, None] * bed.slopes(points)
    if held.end is not None:
        off = points[-1] - held.end
        energy += 0.5 * HOLD * float(off @ off)
        gradient[-1] += HOLD * off
    first, second, way, short = _touching(points, rod)
    energy += 0.5 * CONTACT * rod.edge_mm * float((short**2).sum())
    push = (CONTACT * rod.edge_mm * short)[:, None] * way
    np.add.at(gradient, first, -push)
    np.add.at(gradient, second, push)
    return energy, gradient


def _touching(points: np.ndarray, rod: Rod) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of points, far apart along the rod, that are nearer than it is thick; by how much, and which way."""
    reach = max(2.0 * rod.radius_mm + 0.15, 0.9 * rod.edge_mm)
    first, second = np.triu_indices(len(points), NEIGHBOURS)
    apart = points[first] - points[second]
    square = np.einsum("ij,ij->i", apart, apart)
    near = square < reach**2
    distance = np.sqrt(np.maximum(square[near], 1e-12))
    return first[near], second[near], apart[near] / distance[:, None], reach - distance


def _points(rod: Rod, held: Held, t: np.ndarray) -> np.ndarray:
    return held.start + np.vstack((np.zeros((1, 3)), rod.edge_mm * np.cumsum(t, axis=0)))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _turned(vectors: np.ndarray) -> np.ndarray:
    """ẑ × v."""
    return np.column_stack((-vectors[:, 1], vectors[:, 0], np.zeros(len(vectors))))
