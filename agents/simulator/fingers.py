"""Two hinged fingers against a thread.

The tool frame sits on the hinge: x_tool along the pin, z_tool along the closed fingers. Each finger turns about x_tool
by half the opening θ, so the space between them is a wedge

    |x| ≤ w / 2,   √(y² + z²) ≤ ℓ,   |y| cos θ/2 ≤ z sin θ/2

as wide as the fingers (w) and as long (ℓ). While they close in place they sweep the wedge they closed from, and
whatever thread runs through it ends up between them.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from shared.kinematics.psm import FINGER_M

WIDTH_M = 0.002
"""Of a finger, along the pin."""

ACROSS_DEG = 30.0
"""A thread that runs closer than this to the direction in which the fingers open lies across them, not between."""

FINGERTIP_TOOL = np.array([0.0, 0.0, FINGER_M])


@dataclass(frozen=True)
class Offset:
    """How far the nearest part of a thread is from the wedge, and which way."""

    distance_m: float
    where: str


def between(
    points_tool: Float64[np.ndarray, "n 3"], opening_rad: float, give_m: float = 0.0, near: int | None = None
) -> int | None:
    """The sample at which a thread runs between the fingers, None where it does not.

    Args:
        points_tool: dense samples along the thread, in the tool frame.
        opening_rad: the angle between the fingers.
        give_m: how far a finger may push the thread aside without losing it.
        near: of several strands, the one whose sample is nearest to this one; without it, the most central one.
    """
    candidates = _passages(points_tool)
    y, z = np.abs(points_tool[candidates, 1]), points_tool[candidates, 2]
    half = _half(opening_rad)
    beyond_face = y * np.cos(half) - z * np.sin(half)
    caught = (z > 0) & (np.hypot(y, z) <= FINGER_M) & (beyond_face <= give_m) & ~_lies_across(points_tool, candidates)
    inside = candidates[caught]
    if not len(inside):
        return None
    rank = np.abs(points_tool[inside, 1]) if near is None else np.abs(inside - near)
    return int(inside[np.argmin(rank)])


def within_reach(points: Float64[np.ndarray, "n 3"], pin: Float64[np.ndarray, "3"]) -> bool:
    """Whether any of the points is near enough to the pin to be between fingers, however they are turned."""
    off = points - pin
    return bool((np.einsum("ij,ij->i", off, off) <= (FINGER_M + WIDTH_M) ** 2).any())


def contact_rad(from_pin_m: float, thread_radius_m: float) -> float:
    """The opening at which both fingers touch a thread that far from the pin."""
    return float(2.0 * np.arcsin(min(thread_radius_m / max(from_pin_m, thread_radius_m), 1.0)))


def offset_from_wedge(points_tool: Float64[np.ndarray, "n 3"], opening_rad: float) -> Offset:
    """Where the nearest part of a thread lies that the wedge does not hold."""
    x, y, z = np.abs(points_tool[:, 0]), np.abs(points_tool[:, 1]), points_tool[:, 2]
    half = _half(opening_rad)
    reach = np.hypot(y, z)
    along_face = np.clip(y * np.sin(half) + z * np.cos(half), 0.0, FINGER_M)
    from_face = np.hypot(y - along_face * np.sin(half), z - along_face * np.cos(half))
    facing = np.arctan2(y, z) <= half
    in_plane = np.where(facing, np.maximum(reach - FINGER_M, 0.0), from_face)
    sideways = np.maximum(x - 0.5 * WIDTH_M, 0.0)
    distance = np.hypot(in_plane, sideways)
    nearest = int(np.argmin(distance))
    if distance[nearest] == 0:
        return Offset(0.0, "across the fingers")
    if sideways[nearest] > in_plane[nearest]:
        return Offset(float(distance[nearest]), "to the side of the fingers")
    past_tips = reach[nearest] > FINGER_M or z[nearest] > along_face[nearest]
    return Offset(float(distance[nearest]), "beyond the fingertips" if past_tips else "beside the fingers")


def _passages(points_tool: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, "p"]:
    """For each stretch of thread that the fingers are wide enough to meet, its sample nearest to their middle."""
    off_middle = np.abs(points_tool[:, 0])
    met = np.flatnonzero(off_middle <= 0.5 * WIDTH_M)
    stretches = np.split(met, np.flatnonzero(np.diff(met) > 1) + 1)
    nearest = [stretch[np.argmin(off_middle[stretch])] for stretch in stretches if len(stretch)]
    return np.array(nearest, dtype=np.int64)


def _lies_across(points_tool: Float64[np.ndarray, "n 3"], samples: Int64[np.ndarray, "p"]) -> Bool[np.ndarray, "p"]:
    after, before = np.minimum(samples + 1, len(points_tool) - 1), np.maximum(samples - 1, 0)
    tangent = points_tool[after] - points_tool[before]
    return np.abs(tangent[:, 1]) > np.cos(np.radians(ACROSS_DEG)) * np.linalg.norm(tangent, axis=1)


def _half(opening_rad: float) -> float:
    return float(np.clip(0.5 * opening_rad, 0.0, 0.5 * np.pi))
