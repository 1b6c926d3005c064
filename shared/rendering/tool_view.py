"""A PSM's instrument drawn over a stereo pair: shaft, wrist and two fingers as its kinematics have them, lit from
beside the lens, for what is to be tried on images of tools without a path tracer.

Triangles are filled from the farthest to the nearest at twice the resolution, each in the colour that its normal gives
it: diffuse and glossy light of two lamps (Blinn, 1977), and a reddish reflection of the tissue around. Lengths are
millimetres, points in the left camera's frame.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from schemas.messages import RectifiedStereo
from shared.kinematics.psm import shaft_and_pin
from shared.rendering.path_traced.solids import METALS, Solid, loft

FINE = 2
NEAREST_MM = 4.0
LAMPS_MM = ((-4.0, -3.0, 0.0), (9.5, -3.0, 0.0))
TISSUE_RGB = np.array((150.0, 60.0, 55.0))
BLOOD_RGB = np.array((110.0, 18.0, 16.0))


@dataclass(frozen=True)
class Instrument:
    """Measures of a tool in mm: of the shaft, from its end to the pin, of a finger; and how it looks.

    Fields:
        gloss: how bright its highlights are, 0 to 1.
        stains: how many patches of blood there are on it.
    """

    shaft_radius: float = 4.2
    wrist_length: float = 9.1
    finger_length: float = 10.2
    finger_half_width: float = 1.9
    finger_thickness: float = 1.7
    shaft_metal: str = "dark"
    gloss: float = 0.7
    stains: int = 0


def solids_of(
    T_camera_base: Float64[np.ndarray, "4 4"],
    T_base_tool: Float64[np.ndarray, "4 4"],
    jaw_rad: float,
    tool: Instrument,
) -> list[Solid]:
    """The tool's parts; poses in metres. Its shaft goes on to the remote centre."""
    end, pin = (1e3 * p for p in shaft_and_pin(T_base_tool))
    T = T_camera_base.copy()
    T[:3, 3] *= 1e3
    x_tool, z_tool = T[:3, :3] @ T_base_tool[:3, 0], T[:3, :3] @ T_base_tool[:3, 2]
    end, pin, remote = (T[:3, :3] @ p + T[:3, 3] for p in (end, pin, np.zeros(3)))
    r = tool.shaft_radius
    t = np.linspace(0.0, 1.0, 70)
    centres = remote + t[:, None] * (end - remote)
    across = np.cross(end - remote, x_tool)
    size = np.full(len(t), r)
    parts = [loft(centres, size, size, across, tool.shaft_metal, 0.0 if tool.shaft_metal == "dark" else 0.85)]
    s = np.linspace(-0.25, 1.15, 9)[:, None]
    size = r * np.interp(s[:, 0], (-0.25, 0.0, 0.3, 1.0, 1.15), (0.9, 0.93, 0.8, 0.7, 0.45))
    parts.append(loft(end + s * (pin - end), size, size, x_tool, "steel", 0.9))
    for side in (-1.0, 1.0):
        half = 0.5 * jaw_rad * side
        along = np.cos(half) * z_tool + np.sin(half) * np.cross(x_tool, z_tool) * -1.0
        thick_way = np.cross(x_tool, along)
        t = np.linspace(0.0, 1.0, 12)
        taper = np.sqrt(np.maximum(1.0 - t**8, 1e-3)) * (1.0 - 0.5 * t)
        offset = -side * 0.45 * tool.finger_thickness * taper
        centres = pin + (tool.finger_length * t)[:, None] * along + offset[:, None] * thick_way
        parts.append(
            loft(centres, tool.finger_half_width * taper, 0.5 * tool.finger_thickness * taper, x_tool, "steel", 0.9)
        )
    return parts


def draw_solids(
    image: UInt8[np.ndarray, "h w 3"],
    camera: RectifiedStereo,
    solids: list[Solid],
    tool: Instrument,
    eye_x_mm: float,
    seed: int,
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w"]]:
    """The image with the solids over it, and how much of each pixel they cover (0 to 255)."""
    corners = np.concatenate([solid.vertices[solid.faces] for solid in solids])
    colours = np.concatenate([_shaded(solid, tool, seed + i) for i, solid in enumerate(solids)])
    depth = corners[..., 2]
    u = camera.fx_px * (corners[..., 0] - eye_x_mm) / np.maximum(depth, NEAREST_MM) + camera.cx_px
    v = camera.fy_px * corners[..., 1] / np.maximum(depth, NEAREST_MM) + camera.cy_px
    seen = (depth > NEAREST_MM).all(axis=1)
    size = (camera.image_height, camera.image_width)
    inside = (u.max(axis=1) > 0) & (u.min(axis=1) < size[1]) & (v.max(axis=1) > 0) & (v.min(axis=1) < size[0])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces_us = np.einsum("ij,ij->i", normals, corners.mean(axis=1) - (eye_x_mm, 0.0, 0.0)) < 0
    order = np.flatnonzero(seen & inside & faces_us)
    order = order[np.argsort(-depth[order].mean(axis=1))]
    fine = cv2.resize(image, None, fx=FINE, fy=FINE, interpolation=cv2.INTER_LINEAR)
    cover = np.zeros(fine.shape[:2], np.uint8)
    # centres of fine pixels lie a quarter of a pixel beside that of the coarse one
    polygons = np.rint(16 * (FINE * (np.stack((u, v), -1) + 0.5) - 0.5)).clip(-1 << 20, 1 << 20).astype(np.int32)
    for i in order:
        cv2.fillConvexPoly(fine, polygons[i], colours[i].tolist(), cv2.LINE_8, 4)
        cv2.fillConvexPoly(cover, polygons[i], 255, cv2.LINE_8, 4)
    shrunk = cv2.resize(fine, size[::-1], interpolation=cv2.INTER_AREA)
    mask = cv2.resize(cover, size[::-1], interpolation=cv2.INTER_AREA)
    return np.where(mask[..., None] > 0, shrunk, image), mask


def _shaded(solid: Solid, tool: Instrument, seed: int) -> Float64[np.ndarray, "f 3"]:
    """The colour of each face, blue first."""
    corners = solid.vertices[solid.faces]
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    view = -centre / np.linalg.norm(centre, axis=1, keepdims=True)
    base = 255.0 * np.array(METALS[solid.metal])
    rgb = np.zeros((len(centre), 3))
    for lamp in LAMPS_MM:
        way = np.array(lamp) - centre
        distance = np.linalg.norm(way, axis=1)
        light = way / distance[:, None]
        fall = np.clip((75.0 / distance) ** 2, 0.3, 2.5)
        diffuse = np.clip(np.einsum("ij,ij->i", normal, light), 0, None)
        half = light + view
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        gloss = np.clip(np.einsum("ij,ij->i", normal, half), 0, None) ** (20 if solid.metallic < 0.5 else 45)
        rgb += 0.5 * fall[:, None] * (0.8 * diffuse[:, None] * base + 255.0 * tool.gloss * gloss[:, None])
    rng = np.random.default_rng([seed, 11])
    reflected = 0.5 + 0.5 * np.sin(normal @ rng.normal(0, 3.0, 3) + rng.uniform(0, 6))
    rgb += (0.06 + 0.14 * solid.metallic) * reflected[:, None] * TISSUE_RGB
    for _ in range(tool.stains):
        at = centre[rng.integers(len(centre))]
        near = np.exp(-0.5 * (np.linalg.norm(centre - at, axis=1) / rng.uniform(1.0, 3.0)) ** 2)
        rgb += 0.85 * near[:, None] * (BLOOD_RGB - rgb)
    return np.clip(rgb[:, ::-1], 0, 255)
