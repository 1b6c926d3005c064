"""Threads as mechanics lays them: out of a stitch, over the tissue, to a needle, a gripper, a stitch or a free end."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.scene.path_traced.rod import Bed, Held, Rod, rest_state, smooth_line
from shared.scene.path_traced.splines import curve_through
from shared.scene.path_traced.strands import Strand
from shared.scene.surface import Surface, depth_at_points
from shared.scene.thread_shapes import ShapeError

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
