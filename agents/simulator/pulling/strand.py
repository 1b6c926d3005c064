"""One strand as a chain of nodes, from its hole on, and how it comes to rest in a step of time.

Implicit Euler without inertia: each step finds the minimum of

    ½ Σ EA/ℓ (l − ℓ)² + Σ EI/(a + b) |D − κ₀ (a + b)/2|² + weight + tissue + anchors + ½ Σ c |x − x₀|² / Δt

over the nodes x by Newton's method on a banded matrix, with Coulomb's friction as drag that is weighed anew in each
iteration by how fast a node slides (μ N / |v|); l are the lengths of the segments, ℓ those at rest, D the change
of direction between two segments a and b, κ₀ the curvature as drawn, which turns with the thread. A pull is so slow
that inertia does not count: steps are 40 times as long as those of contact physics. The lengths at rest may change from
step to step, as they do where thread runs through a hole or a jaw, and the thread stretches; the capsules of contact
physics do neither. Millimetres, newtons, seconds.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.linalg import solveh_banded

from shared.rendering.surface import Surface, depth_at_points

ITERATIONS, DONE_MM, LONGEST_MM = 40, 1e-5, 2.0
"""Of Newton's method: how many, what change ends it, and how far a node goes in one of them."""
PINNED = 1e4
"""Stiffness that keeps a node in its place, in N/mm; a thread's own is 50 N/mm a segment."""
CREEP_MM_PER_S = 0.02
"""Friction is viscous below this speed, and Coulomb's above it."""
SHORT, LONG = 0.4, 1.6
"""Beside a hole or a jaw, segments shorter or longer than this, in usual ones, are joined or divided."""
SLOPE_OVER_MM = 0.5
_EYE = np.eye(3)


@dataclass(frozen=True)
class Law:
    """What a strand is made of, and what it lies on.

    Fields:
        axial: E A, in N; bending: E I, in N mm².
        weight: N/mm; tissue: stiffness of the tissue beneath a millimetre of it, N/mm².
        friction: Coulomb's coefficient on the tissue's surface.
        bath: viscous drag of a millimetre, N s/mm²: how fast what is free comes to rest.
    """

    axial: float
    bending: float
    weight: float
    tissue: float
    friction: float
    radius: float
    segment: float
    bath: float = 3e-8


@dataclass(frozen=True)
class Strand:
    """A chain from its hole on.

    Fields:
        rest: lengths of its segments at rest.
        bend: curvature vectors at rest, where the thread is now; those of both ends count for nothing.
    """

    points: Float64[np.ndarray, "n 3"]
    rest: Float64[np.ndarray, "m"]
    bend: Float64[np.ndarray, "n 3"]

    @property
    def length(self) -> float:
        """At rest."""
        return float(self.rest.sum())


@dataclass(frozen=True)
class Anchor:
    """A spring, in N/mm, that keeps a node at a place."""

    node: int
    place: Float64[np.ndarray, "3"]
    stiffness: float = PINNED


def strand_along(points: Float64[np.ndarray, "n 3"], law: Law) -> Strand:
    """A strand at rest along a polyline."""
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    segments = max(round(way[-1] / law.segment), 2)
    even = np.linspace(0.0, way[-1], segments + 1)
    nodes = np.column_stack([np.interp(even, way, axis) for axis in points.T])
    rest = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    return Strand(nodes, rest, _curvature(nodes, rest))


def tensions(strand: Strand, law: Law) -> Float64[np.ndarray, "m"]:
    """Of each segment in newtons; a thread that is pressed together has none."""
    lengths = np.linalg.norm(np.diff(strand.points, axis=0), axis=1)
    return law.axial * np.maximum(lengths / strand.rest - 1.0, 0.0)


def rested(strand: Strand, law: Law, surface: Surface, anchors: tuple[Anchor, ...], elapsed_s: float) -> Strand:
    """The strand after a step of time."""
    before, rest = strand.points, strand.rest
    lumped = 0.5 * (np.append(rest, 0.0) + np.insert(rest, 0, 0.0))
    normals = _normals(surface, before)
    bath = law.bath * np.maximum(lumped, 1e-3)
    holds = law.friction * law.tissue * lumped * _depth(before, law, surface) * -normals[:, 2]
    across = _EYE - normals[:, :, None] * normals[:, None, :]
    speed = np.full(len(before), CREEP_MM_PER_S)
    x = before.copy()
    for _ in range(ITERATIONS):
        force, diagonal, next_to, beyond = _elastic(x, strand, law)
        depth = _depth(x, law, surface) * -normals[:, 2]
        depth[0] = 0.0
        stiff = law.tissue * lumped
        force[:, 2] += law.weight * lumped
        force += (stiff * depth)[:, None] * normals
        diagonal += (stiff * (depth > 0))[:, None, None] * normals[:, :, None] * normals[:, None, :]
        viscous = (bath[:, None, None] * _EYE + (holds / speed)[:, None, None] * across) / elapsed_s
        force -= np.einsum("nij,nj->ni", viscous, x - before)
        diagonal += viscous
        for anchor in anchors:
            force[anchor.node] += anchor.stiffness * (anchor.place - x[anchor.node])
            diagonal[anchor.node] += anchor.stiffness * _EYE
        step = solveh_banded(_banded(diagonal, next_to, beyond), force.ravel(), lower=True).reshape(-1, 3)
        longest = float(np.linalg.norm(step, axis=1).max())
        x = x + step * min(1.0, LONGEST_MM / max(longest, 1e-12))
        if longest < DONE_MM:
            break
        along = np.linalg.norm(np.einsum("nij,nj->ni", across, x - before), axis=1)
        speed = np.maximum(along / elapsed_s, CREEP_MM_PER_S)
    return replace(strand, points=x, bend=_turned(strand.bend, _directions(before), _directions(x)))


def with_place(strand: Strand, place_mm: float, law: Law) -> tuple[Strand, int]:
    """The strand with a node so far along it, and which one that is."""
    way = np.concatenate(([0.0], np.cumsum(strand.rest)))
    after = int(np.clip(np.searchsorted(way, place_mm), 1, len(strand.rest)))
    share = float(np.clip((place_mm - way[after - 1]) / strand.rest[after - 1], 0.0, 1.0))
    return meshed(_divided(strand, after - 1, share), law, after)


def meshed(strand: Strand, law: Law, fixed: int | None = None) -> tuple[Strand, int]:
    """The strand without segments that are too short or too long, and where its fixed node is then."""
    at = -1 if fixed is None else fixed
    while len(strand.rest) > 1 and strand.rest.min() < SHORT * law.segment:
        k = int(np.argmin(strand.rest))
        inner = [node for node in (k, k + 1) if 0 < node < len(strand.rest) and node != at]
        if not inner:
            break
        strand, at = _joined(strand, inner[0]), at - (inner[0] < at)
    while strand.rest.max() > LONG * law.segment:
        k = int(np.argmax(strand.rest))
        strand, at = _divided(strand, k, 0.5), at + (k < at)
    return strand, at


def _divided(strand: Strand, segment: int, share: float) -> Strand:
    points, rest, k = strand.points, strand.rest, segment
    between = points[k] + share * (points[k + 1] - points[k])
    parts = (share * rest[k], (1.0 - share) * rest[k])
    middle = (1.0 - share) * strand.bend[k] + share * strand.bend[k + 1] if k else np.zeros(3)
    return Strand(
        np.insert(points, k + 1, between, axis=0),
        np.concatenate((rest[:k], parts, rest[k + 1 :])),
        np.insert(strand.bend, k + 1, middle, axis=0),
    )


def _joined(strand: Strand, node: int) -> Strand:
    rest = np.delete(strand.rest, node)
    rest[node - 1] += strand.rest[node]
    return Strand(np.delete(strand.points, node, axis=0), rest, np.delete(strand.bend, node, axis=0))


Blocks = Float64[np.ndarray, "n 3 3"]


def _elastic(x: Float64[np.ndarray, "n 3"], strand: Strand, law: Law) -> tuple[np.ndarray, Blocks, Blocks, Blocks]:
    """Elastic forces, and their stiffness: of each node, to the next one, and to the one after that."""
    n, rest = len(x), strand.rest
    force, diagonal = np.zeros((n, 3)), np.zeros((n, 3, 3))
    next_to, beyond = np.zeros((n - 1, 3, 3)), np.zeros((max(n - 2, 0), 3, 3))
    step = np.diff(x, axis=0)
    length = np.maximum(np.linalg.norm(step, axis=1), 1e-9)
    u = step / length[:, None]
    k = law.axial / rest
    pull = (k * (length - rest))[:, None] * u
    force[:-1] += pull
    force[1:] -= pull
    along = u[:, :, None] * u[:, None, :]
    # a segment under pressure would turn aside without limit; its neighbours' bending keeps it
    aside = np.maximum(1.0 - rest / length, 0.0)[:, None, None]
    block = k[:, None, None] * (along + aside * (_EYE - along))
    diagonal[:-1] += block
    diagonal[1:] += block
    next_to -= block
    if n > 2:
        a, b = rest[:-1], rest[1:]
        weights = np.stack((1.0 / a, -1.0 / a - 1.0 / b, 1.0 / b), axis=1)
        nodes = np.stack((x[:-2], x[1:-1], x[2:]), axis=1)
        off = np.einsum("nk,nki->ni", weights, nodes) - strand.bend[1:-1] * (0.5 * (a + b))[:, None]
        stiff = 2.0 * law.bending / (a + b)
        for i in range(3):
            force[i : n - 2 + i] -= (stiff * weights[:, i])[:, None] * off
            diagonal[i : n - 2 + i] += (stiff * weights[:, i] ** 2)[:, None, None] * _EYE
        for i in range(2):
            next_to[i : n - 2 + i] += (stiff * weights[:, i] * weights[:, i + 1])[:, None, None] * _EYE
        beyond += (stiff * weights[:, 0] * weights[:, 2])[:, None, None] * _EYE
    return force, diagonal, next_to, beyond


def _banded(diagonal: Blocks, next_to: Blocks, beyond: Blocks) -> Float64[np.ndarray, "9 m"]:
    """The lower bands of the symmetric matrix, as SciPy takes them."""
    n = len(diagonal)
    bands = np.zeros((9, 3 * n))
    for row in range(3):
        for column in range(3):
            if row >= column:
                bands[row - column, column::3] = diagonal[:, row, column]
            bands[3 + row - column, column : 3 * (n - 1) : 3] = next_to[:, column, row]
            bands[6 + row - column, column : 3 * max(n - 2, 0) : 3] = beyond[:, column, row]
    return bands


def _depth(points: Float64[np.ndarray, "n 3"], law: Law, surface: Surface) -> Float64[np.ndarray, "n"]:
    """How deep each node lies in the tissue, along the view."""
    return np.maximum(points[:, 2] + law.radius - depth_at_points(surface, points[:, :2]), 0.0)


def _normals(surface: Surface, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Of the tissue beneath points, towards the camera."""
    step = SLOPE_OVER_MM
    offsets = np.array([(step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)])
    depth = depth_at_points(surface, (offsets[:, None] + points[:, :2]).reshape(-1, 2)).reshape(4, -1)
    normal = np.column_stack((depth[0] - depth[1], depth[2] - depth[3], np.full(len(points), -2.0 * step)))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _curvature(points: Float64[np.ndarray, "n 3"], rest: Float64[np.ndarray, "m"]) -> Float64[np.ndarray, "n 3"]:
    bend, slope = np.zeros_like(points), np.diff(points, axis=0) / rest[:, None]
    bend[1:-1] = 2.0 * np.diff(slope, axis=0) / (rest[1:] + rest[:-1])[:, None]
    return bend


def _directions(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Unit tangents at the nodes."""
    way = np.gradient(points, axis=0)
    return way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)


def _turned(
    vectors: Float64[np.ndarray, "n 3"], before: Float64[np.ndarray, "n 3"], after: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """The vectors after the shortest turns from one direction to another each (Rodrigues)."""
    axis = np.cross(before, after)
    cosine = np.einsum("ni,ni->n", before, after)[:, None]
    along = np.einsum("ni,ni->n", axis, vectors)[:, None]
    return cosine * vectors + np.cross(axis, vectors) + axis * along / np.maximum(1.0 + cosine, 1e-6)
