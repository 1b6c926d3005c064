"""Instruments and needles: tubes of elliptical section along a line, as triangles.

An instrument has a round shaft, a wrist, and two jaws. It comes from outside the image, nearer to the camera than the
tissue, and points at its tip.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from schemas.messages import RectifiedStereo
from shared.rendering.path_traced.splines import Curve, curve_through

SIDES = 28
SHAFT_MM = 160.0
TAPERS = 0.25
"""The share of a needle's length over which it comes to its point."""
METALS = {
    "steel": (0.62, 0.60, 0.57),
    "dark": (0.16, 0.16, 0.17),
    "bright": (0.85, 0.84, 0.82),
    "worn": (0.62, 0.60, 0.57),
    "black": (0.012, 0.012, 0.013),
}


@dataclass(frozen=True)
class Solid:
    """Triangles of one material: vertices in mm, faces as indices of three.

    Fields:
        normals: of the vertices, unit; None where they follow from the triangles.
        texture: where the vertices lie on a finish, in mm; None for lofts, whose finish has no pattern.
        finish: of its surface (`materials.py`).
    """

    vertices: Float64[np.ndarray, "n 3"]
    faces: Int64[np.ndarray, "f 3"]
    metal: str
    metallic: float
    normals: Float64[np.ndarray, "n 3"] | None = None
    texture: Float64[np.ndarray, "n 2"] | None = None
    finish: str = "plain"

    @property
    def is_lofted(self) -> bool:
        """Whether its vertices are rings of `SIDES`, one after another, and the middles of both caps."""
        return self.normals is None


@dataclass(frozen=True)
class Needle:
    """A curved needle: its centreline from where the thread enters it to its point, and its radius in mm."""

    curve: Curve
    radius_mm: float

    def radius_at(self, share: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
        """Its radius in mm at such a share of its length: it tapers towards its point."""
        return self.radius_mm * np.clip((1.0 - share) / TAPERS, 0.0, 1.0)


@dataclass(frozen=True)
class Pose:
    """Where an instrument's jaws close, and unit vectors: towards its shaft, and across its jaws."""

    tip: Float64[np.ndarray, "3"]
    towards_shaft: Float64[np.ndarray, "3"]
    across: Float64[np.ndarray, "3"]


def loft(
    centres: Float64[np.ndarray, "n 3"],
    wide: Float64[np.ndarray, "n"],
    thick: Float64[np.ndarray, "n"],
    across: Float64[np.ndarray, "3"],
    metal: str,
    metallic: float,
) -> Solid:
    """A closed tube through centres, with half-axes `wide` along `across` and `thick` at right angles to it."""
    along = np.gradient(centres, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    first = across - (along @ across)[:, None] * along
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    angle = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
    rings = centres[:, None] + np.cos(angle)[:, None] * (wide[:, None] * first)[:, None]
    rings = rings + np.sin(angle)[:, None] * (thick[:, None] * second)[:, None]
    vertices = np.vstack((rings.reshape(-1, 3), centres[:1], centres[-1:]))
    ring = np.arange(len(centres) - 1)[:, None] * SIDES
    a, b = ring + np.arange(SIDES), ring + (np.arange(SIDES) + 1) % SIDES
    sides = [np.stack((a, b, a + SIDES), -1).reshape(-1, 3), np.stack((b, b + SIDES, a + SIDES), -1).reshape(-1, 3)]
    here, following = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    last = (len(centres) - 1) * SIDES
    start, end = len(vertices) - 2, len(vertices) - 1
    caps = [
        np.column_stack((following, here, np.full(SIDES, start))),
        np.column_stack((here + last, following + last, np.full(SIDES, end))),
    ]
    return Solid(vertices, np.vstack(sides + caps), metal, metallic)


def instrument(pose: Pose, radius_mm: float, opening_rad: float, metal: str, rng: np.random.Generator) -> list[Solid]:
    """Shaft, wrist and two jaws that meet `opening_rad` apart where they hinge."""
    jaw_mm, wrist_mm = rng.uniform(9.0, 15.0), rng.uniform(4.0, 8.0)
    hinge = pose.tip + jaw_mm * pose.towards_shaft
    parts: list[Solid] = []
    for side in (-1.0, 1.0):
        turned = np.cos(0.5 * opening_rad) * pose.towards_shaft - side * np.sin(0.5 * opening_rad) * pose.across
        t = np.linspace(0.0, 1.0, 14)
        centres = hinge + side * 0.14 * radius_mm * pose.across - (jaw_mm * t)[:, None] * turned
        taper = np.sqrt(np.maximum(1.0 - t**6, 0.0)) * (1.0 - 0.55 * t)
        parts.append(loft(centres, 0.26 * radius_mm * taper, 0.45 * radius_mm * taper, pose.across, "steel", 0.9))
    t = np.linspace(-0.3, 1.0, 10)
    centres = hinge + (wrist_mm * t)[:, None] * pose.towards_shaft
    size = radius_mm * np.interp(t, (-0.3, -0.1, 0.6, 1.0), (0.3, 0.62, 0.75, 0.97))
    parts.append(loft(centres, size, size, pose.across, "steel", 0.9))
    t = np.array([0.0, 0.004, 0.02, 0.021, 0.024, 0.025, 0.5, 1.0])
    size = radius_mm * np.array([0.9, 1.0, 1.0, 0.94, 0.94, 1.0, 1.0, 1.0])
    centres = hinge + (wrist_mm + SHAFT_MM * t)[:, None] * pose.towards_shaft
    parts.append(loft(centres, size, size, pose.across, metal, 0.0 if metal == "dark" else 0.85))
    return parts


def pose_towards(tip: Float64[np.ndarray, "3"], image_angle: float, rise_rad: float, roll_rad: float) -> Pose:
    """An instrument that comes from `image_angle` in the image plane, rising towards the camera away from its tip."""
    flat = np.array([np.cos(image_angle), np.sin(image_angle), 0.0])
    towards = np.cos(rise_rad) * flat - np.sin(rise_rad) * np.array([0.0, 0.0, 1.0])
    side = np.cross(towards, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    third = np.cross(towards, side)
    return Pose(tip, towards, np.cos(roll_rad) * side + np.sin(roll_rad) * third)


def silhouette(camera: RectifiedStereo, solids: list[Solid], eye_x_mm: float = 0.0) -> UInt8[np.ndarray, "h w"]:
    """Which pixels solids cover in the eye at (eye_x_mm, 0, 0), 0 or 255: quick, for choosing where to put them."""
    image = np.zeros((camera.image_height, camera.image_width), dtype=np.uint8)
    for solid in solids:
        depth = np.maximum(solid.vertices[:, 2], 5.0)
        u = camera.fx_px * (solid.vertices[:, 0] - eye_x_mm) / depth + camera.cx_px
        v = camera.fy_px * solid.vertices[:, 1] / depth + camera.cy_px
        pixels = np.clip(np.stack((u, v), -1), -8000, 8000).astype(np.int32)
        if solid.is_lofted:
            for one, other in pairwise(pixels[:-2].reshape(-1, SIDES, 2)):
                cv2.fillConvexPoly(image, cv2.convexHull(np.vstack((one, other))), 255)
            continue
        for triangle in np.unique(pixels[solid.faces].reshape(-1, 6), axis=0).reshape(-1, 3, 2):
            cv2.fillConvexPoly(image, triangle, 255)
    return image


def needle_from(
    end: Float64[np.ndarray, "3"],
    outward: Float64[np.ndarray, "3"],
    up: Float64[np.ndarray, "3"],
    arc_radius_mm: float,
    arc_rad: float,
    radius_mm: float,
) -> Needle:
    """A needle that is an arc of a circle, entered by the thread at `end`, and bent towards `up`."""
    bend = up - (up @ outward) * outward
    bend /= np.linalg.norm(bend)
    angle = np.linspace(0.0, arc_rad, 200)[:, None]
    points = end + arc_radius_mm * (np.sin(angle) * outward + (1.0 - np.cos(angle)) * bend)
    return Needle(curve_through(points, 0.6), radius_mm)
