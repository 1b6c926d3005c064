"""Rest states of a thread as an elastic rod: clamped where it leaves the tissue or is held, lying on what is below.

A rod that does not stretch is a chain of edges of length h with unit tangents t. Its energy over its stiffness B,

    E / B = Σ |t_{i+1} − t_i − κ h (ẑ × t_i)|² / 2h  −  (w / B) h Σ z  +  penalties for contact and for its held end,

is least at rest (Bergou et al. 2008, Discrete elastic rods, without twist, which a braid hardly resists). κ is the
curvature that it keeps from its packet, and w its weight, which pulls along +z, away from the camera.
Lengths in mm, points in the left camera's frame.

So threads lie: out of a stitch, over the tissue, to a needle, a gripper, a stitch or a free end.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.optimize import minimize

from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.rendering.path_traced.ground import grid_axes
from shared.rendering.path_traced.splines import Strand, curve_through
from shared.rendering.surface import Surface, depth_at_points
from shared.rendering.thread_shapes import ShapeError

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


Ending = Literal["free", "stitch", "needle", "gripper"]
ENDINGS: tuple[Ending, ...] = ("free", "stitch", "needle", "gripper")
EDGE_MM = 0.8
DEPTH_OF_STITCH_MM = 0.8
BURIED = 2
MARGIN_PX = 20.0
ATTEMPTS = 14


@dataclass(frozen=True)
class Pinned:
    """A strand at rest, how it ends, and the direction in which its end points."""

    strand: Strand
    ending: Ending
    direction: Float64[np.ndarray, "3"]


def pinned_strand(
    camera: RectifiedStereo,
    surface: Surface,
    rng: np.random.Generator,
    radius_mm: float,
    dye: str,
    inside_share: float = 1.0,
) -> Pinned:
    """A thread at rest of which both images show at least this share.

    Raises:
        ShapeError: where none was found; the text says what would do.
    """
    bed = Bed(surface)
    for _ in range(ATTEMPTS):
        ending = ENDINGS[int(rng.integers(len(ENDINGS)))]
        rod = Rod(
            EDGE_MM,
            radius_mm,
            bearing_length_mm=float(rng.uniform(10.0, 35.0)),
            kept_curvature=float(rng.normal(0.0, 0.03)),
        )
        tangents = _let_go(rng)
        held = _held(camera, surface, tangents, ending, rng)
        points = rest_state(rod, held, tangents, bed)
        if _is_sound(points, rod) and _share_inside(camera, points) >= inside_share:
            line = smooth_line(points)
            return Pinned(Strand(curve_through(line), radius_mm, dye), ending, (points[-1] - points[-2]) / EDGE_MM)
    raise ShapeError("found no thread at rest that fits into both images at this distance; use a wider view")


def _let_go(rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """Directions of a wandering path in the image plane, with the length that it has."""
    count = int(rng.uniform(45.0, 120.0) / EDGE_MM)
    wander = cv2.GaussianBlur(rng.normal(0.0, 1.0, (1, 3 * count)), (0, 0), rng.uniform(5.0, 14.0)).ravel()
    turn = wander[count : 2 * count] / max(float(wander.std()), 1e-9) * rng.uniform(0.02, 0.09)
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(turn + rng.normal(0.0, 0.02))
    # one strand that comes to lie on another has to know which
    climb = np.linspace(0.0, rng.uniform(0.0, 0.12), count)
    return np.column_stack((np.cos(heading), np.sin(heading), -climb))


def _held(
    camera: RectifiedStereo, surface: Surface, tangents: np.ndarray, ending: Ending, rng: np.random.Generator
) -> Held:
    flat = EDGE_MM * np.cumsum(tangents[:, :2], axis=0)
    half = 0.5 * np.ptp(flat, axis=0)
    middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    distance = float(surface.depth_mm.mean())
    room = np.array([camera.image_width, camera.image_height]) * 0.5 * distance / camera.fx_px - half
    wanted = rng.uniform(-1.0, 1.0, 2) * np.maximum(room, 0.0) * 0.8 + np.array([0.5 * camera.baseline, 0.0])
    start = wanted - middle
    # what a stretched chain would reach, its ends are held a little nearer than
    end = start + flat[-1] * rng.uniform(0.75, 1.0)
    first = _leaving(tangents[0], rng.uniform(0.2, 1.1))
    start_point = np.array([*start, _depth(surface, start) + DEPTH_OF_STITCH_MM])
    if ending == "free":
        return Held(start_point, first, buried=(BURIED, 0))
    depth = _depth(surface, end)
    if ending == "stitch":
        last = -_leaving(-tangents[-1], rng.uniform(0.2, 1.1))
        return Held(start_point, first, np.array([*end, depth + DEPTH_OF_STITCH_MM]), last, (BURIED, BURIED))
    height = rng.uniform(4.0, 18.0) if ending == "gripper" else rng.uniform(0.6, 2.0)
    rise = rng.uniform(-0.3, 0.9) if ending == "gripper" else 0.0
    return Held(start_point, first, np.array([*end, depth - height]), _leaving(tangents[-1], rise), (BURIED, 0))


def _leaving(tangent: np.ndarray, rise_rad: float) -> Float64[np.ndarray, "3"]:
    """The tangent's heading, rising towards the camera by an angle."""
    flat = tangent[:2] / np.linalg.norm(tangent[:2])
    return np.array([*(np.cos(rise_rad) * flat), -np.sin(rise_rad)])


def _depth(surface: Surface, xy: np.ndarray) -> float:
    return float(depth_at_points(surface, xy[None])[0])


def _is_sound(points: np.ndarray, rod: Rod) -> bool:
    """Whether it passes nowhere through itself and bends nowhere sharper than thread does."""
    t = np.diff(points, axis=0) / rod.edge_mm
    sharpest = np.linalg.norm(np.diff(t, axis=0), axis=1).max() / rod.edge_mm
    first, second = np.triu_indices(len(points), 8)
    nearest = np.linalg.norm(points[first] - points[second], axis=1).min()
    return bool(sharpest < 0.7 and nearest > 2.0 * rod.radius_mm)


def _share_inside(camera: RectifiedStereo, points: np.ndarray) -> float:
    if points[:, 2].min() < 30.0:
        return 0.0
    last = np.array([camera.image_width, camera.image_height]) - 1.0 - MARGIN_PX
    shares = [((pixels > MARGIN_PX) & (pixels < last)).all(axis=1).mean() for pixels in project(camera, points)]
    return float(min(shares))
