"""Soft tissue: the planes that stand for it beneath the thread, and how hard fingers press into it.

Beneath each segment of the thread the tissue is the plane that touches its surface there. Under a finger it is a
foundation of springs (Winkler): every part of the finger's outline that is below the surface is pressed upon in
proportion to its depth and to how far it faces the tissue.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from agents.simulator.contact.material import NEWTON, Material
from agents.simulator.contact.model import FINGER_MM, THICKNESS_MM, WIDTH_MM
from shared.rendering.surface import Surface, depth_at_points
from shared.rigid_transforms import apply

SLOPE_OVER_MM = 0.5
ALONG, ACROSS, OUT = 24, 3, 3


def planes_beneath(
    surface: Surface, points: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 4"]]:
    """Where the tissue is beneath points, and attitudes (wxyz) whose z is its normal towards the camera."""
    step = SLOPE_OVER_MM
    offsets = np.array([(0.0, 0.0), (step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)])
    xy = (offsets[:, None] + points[:, :2]).reshape(-1, 2)
    depth = depth_at_points(surface, xy).reshape(5, -1)
    normal = np.column_stack((depth[1] - depth[2], depth[3] - depth[4], np.full(len(points), -2.0 * step)))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # half a turn about x, and then the shortest turn from −z to the normal
    attitude = np.column_stack((-normal[:, 1], 1.0 - normal[:, 2], np.zeros(len(points)), normal[:, 0]))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return np.column_stack((points[:, :2], depth[0])), attitude


def press_n(
    surface: Surface, T_camera_tool: Float64[np.ndarray, "4 4"], half_rad: tuple[float, float], material: Material
) -> float:
    """Force in newtons with which the tissue bears up both fingers, each turned by its half of the opening."""
    total = 0.0
    foundation = material.foundation(WIDTH_MM * THICKNESS_MM)
    for side, half in zip((1, -1), half_rad, strict=True):
        points, normals, areas = _outline(side)
        cos, sin = np.cos(half), side * np.sin(half)
        turned = np.array([[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]])
        at = apply(T_camera_tool, points @ turned.T)
        facing = (normals @ turned.T @ T_camera_tool[:3, :3].T)[:, 2]
        depth = at[:, 2] - depth_at_points(surface, at[:, :2])
        total += float(np.sum(foundation * np.maximum(depth, 0.0) * np.maximum(facing, 0.0) * areas))
    return total / NEWTON


@lru_cache(maxsize=2)
def _outline(side: int) -> tuple[Float64[np.ndarray, "p 3"], Float64[np.ndarray, "p 3"], Float64[np.ndarray, "p"]]:
    """Places on the faces of a closed finger, with their normals and areas; the face at the pin is left out."""

    def middles(cells: int, size: float) -> np.ndarray:
        return size * (np.arange(cells) + 0.5) / cells

    along, across, out = (
        middles(ALONG, FINGER_MM),
        middles(ACROSS, WIDTH_MM) - 0.5 * WIDTH_MM,
        middles(OUT, THICKNESS_MM),
    )
    faces = [
        (across, np.array([0.0]), along, (0.0, -side, 0.0), WIDTH_MM * FINGER_MM),
        (across, np.array([THICKNESS_MM]), along, (0.0, side, 0.0), WIDTH_MM * FINGER_MM),
        (np.array([-0.5 * WIDTH_MM]), out, along, (-1.0, 0.0, 0.0), THICKNESS_MM * FINGER_MM),
        (np.array([0.5 * WIDTH_MM]), out, along, (1.0, 0.0, 0.0), THICKNESS_MM * FINGER_MM),
        (across, out, np.array([FINGER_MM]), (0.0, 0.0, 1.0), WIDTH_MM * THICKNESS_MM),
    ]
    points, normals, areas = [], [], []
    for x, y, z, normal, area in faces:
        grid = np.stack(np.meshgrid(x, side * y, z, indexing="ij"), axis=-1).reshape(-1, 3)
        points.append(grid)
        normals.append(np.tile(normal, (len(grid), 1)))
        areas.append(np.full(len(grid), area / len(grid)))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(areas)
