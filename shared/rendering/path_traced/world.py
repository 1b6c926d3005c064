"""A field as Mitsuba's scene. Its shapes are named, so that a ray's hit tells what it met."""

import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from shared.rendering.path_traced.engine import engine, reinterpreted
from shared.rendering.path_traced.field import Field
from shared.rendering.path_traced.ground import Ground, grid_axes
from shared.rendering.path_traced.lab_light import LabLight
from shared.rendering.path_traced.materials import bitmap, colour, metal, of_solid
from shared.rendering.path_traced.solids import Needle, Solid
from shared.rendering.path_traced.splines import DYES, Strand, end_directions

BRAID_PITCH_MM = 0.8
LAMP = "lamp"
GROUND, STRAND, NEEDLE, TOOL = "ground", "strand", "needle", "tool"


def build(field: Field) -> Any:
    """Mitsuba's scene of the field."""
    mi = engine()
    parts: dict[str, Any] = {"type": "scene", GROUND: _ground(field.ground)}
    parts |= {LAMP: _lamp()} if field.lab_light is None else _lab_lamps(field.lab_light)
    with tempfile.TemporaryDirectory() as folder:
        for index, strand in enumerate(field.strands):
            parts |= _strand(strand, f"{STRAND}{index}", Path(folder))
        if field.needle is not None:
            parts[f"{NEEDLE}0"] = _needle(field.needle, Path(folder))
        for index, tool in enumerate(field.tools):
            parts[f"{TOOL}{index}"] = _solid(tool, f"{TOOL}{index}")
        return mi.load_dict(parts)


def shape_names(scene: Any) -> dict[int, str]:
    """What each value of the `shape_index` of a ray's hit stands for; 0 is nothing.

    The compiled variant counts shapes in the order in which it happened to make them, the other in the scene's.
    """
    mi = engine()
    shapes = list(scene.shapes())
    if not hasattr(mi, "ShapePtr"):
        return {number: str(shape.id()) for number, shape in enumerate(shapes, start=1)}
    return {int(np.array(reinterpreted(mi.ShapePtr(shape)))[0]): str(shape.id()) for shape in shapes}


def _lamp() -> dict[str, Any]:
    """The one lamp, of which each pass of rays makes another."""
    return {
        "type": "spot",
        "intensity": {"type": "rgb", "value": [1.0, 1.0, 1.0]},
        "cutoff_angle": 70.0,
        "beam_width": 40.0,
        "to_world": engine().ScalarTransform4f(np.eye(4)),
    }


def _lab_lamps(light: LabLight) -> dict[str, Any]:
    """All lamps of a lab, and the room."""
    transform = engine().ScalarTransform4f
    lamps: dict[str, Any] = {"room": {"type": "envmap", "bitmap": engine().Bitmap(light.room)}}
    for index, disk in enumerate(light.disks):
        facing = transform().look_at(origin=list(disk.place_mm), target=list(disk.towards_mm), up=[0.1, 1.0, 0.2])
        lamps[f"{LAMP}{index}"] = {
            "type": "disk",
            "to_world": facing @ transform().scale(disk.radius_mm),
            "emitter": {"type": "area", "radiance": colour(disk.radiance)},
        }
    for index, beam in enumerate(light.beams):
        lamps[f"beam{index}"] = {
            "type": "spot",
            "intensity": colour(beam.intensity),
            "cutoff_angle": beam.black_deg,
            "beam_width": beam.full_deg,
            "to_world": transform().look_at(
                origin=list(beam.place_mm), target=list(beam.towards_mm), up=[0.0, 1.0, 0.0]
            ),
        }
    return lamps


def _ground(ground: Ground) -> Any:
    x, y = grid_axes(ground.surface)
    depth = ground.surface.depth_mm
    rows, columns = depth.shape
    points = np.dstack((*np.meshgrid(x, y), depth)).reshape(-1, 3)
    slope_y, slope_x = np.gradient(depth, ground.surface.step_mm)
    normals = np.dstack((slope_x, slope_y, np.full(depth.shape, -1.0)))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.vstack((np.column_stack((a, c, b)), np.column_stack((b, c, d))))
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    material = {
        "type": "twosided",
        "inside": {
            "type": "principled",
            "base_color": bitmap(ground.albedo),
            "roughness": bitmap(ground.roughness[..., None]),
            "specular": 0.45,
            "clearcoat": bitmap(ground.film[..., None]),
            "clearcoat_gloss": 0.92,
        },
    }
    texture = np.column_stack((u.ravel(), 1.0 - v.ravel() if ground.is_mirrored else v.ravel()))
    return _mesh(GROUND, points, faces, material, normals.reshape(-1, 3), texture)


def _mesh(
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    material: dict[str, Any],
    normals: np.ndarray | None = None,
    texture: np.ndarray | None = None,
) -> Any:
    mi = engine()
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(material)
    mesh = mi.Mesh(
        name,
        len(vertices),
        len(faces),
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=texture is not None,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    if normals is not None:
        parameters["vertex_normals"] = normals.astype(np.float32).ravel()
    if texture is not None:
        parameters["vertex_texcoords"] = texture.astype(np.float32).ravel()
    parameters.update()
    mesh.set_id(name)
    return mesh


def _strand(strand: Strand, name: str, folder: Path) -> dict[str, Any]:
    """The tube, and a disk over either of its ends, which Mitsuba leaves open."""
    mi = engine()
    yarn = _yarn(strand)
    parts: dict[str, Any] = {
        name: {
            "type": "bsplinecurve",
            "filename": _curve_file(folder / f"{name}.txt", strand.curve.control_points, strand.radius_mm),
            "bsdf": yarn,
        }
    }
    ends = strand.curve.at(np.array([0.0, float(strand.curve.spans)]))
    for index, (end, outward) in enumerate(zip(ends, end_directions(strand.curve), strict=True)):
        aside = [1.0, 0.0, 0.0] if abs(outward[0]) < 0.7 else [0.0, 1.0, 0.0]
        facing = mi.ScalarTransform4f().look_at(origin=end.tolist(), target=(end + outward).tolist(), up=aside)
        parts[f"{name}end{index}"] = {
            "type": "disk",
            "to_world": facing @ mi.ScalarTransform4f().scale(strand.radius_mm),
            "bsdf": {"type": "twosided", "inside": {"type": "diffuse", "reflectance": colour(DYES[strand.dye])}},
        }
    return parts


def _yarn(strand: Strand) -> dict[str, Any]:
    """The material of a braid: dark furrows between bright ribs that run round it both ways."""
    size = 32
    v, u = np.meshgrid(*(2.0 * np.pi * np.arange(size) / size for _ in range(2)), indexing="ij")
    ribs = 0.5 + 0.25 * (np.cos(v + u) + np.cos(v - u))
    pattern = (0.55 + 0.6 * ribs)[..., None] * np.array(DYES[strand.dye])
    pitches = max(round(strand.curve.spans / BRAID_PITCH_MM), 1)
    return {
        "type": "principled",
        "base_color": {
            **bitmap(np.clip(cv2.GaussianBlur(pattern, (3, 3), 0), 0.0, 0.95)),
            "wrap_mode": "repeat",
            "to_uv": engine().ScalarTransform4f().scale([pitches, 3.0, 1.0]),
        },
        "roughness": 0.34,
        "specular": 0.5,
    }


def _needle(needle: Needle, folder: Path) -> dict[str, Any]:
    points = needle.curve.control_points
    return {
        "type": "bsplinecurve",
        "filename": _curve_file(folder / "needle.txt", points, needle.radius_at(np.linspace(0.0, 1.0, len(points)))),
        "bsdf": metal("bright", 1.0, 0.22),
    }


def _solid(solid: Solid, name: str) -> Any:
    normals = _normals(solid) if solid.normals is None else solid.normals
    return _mesh(name, solid.vertices, solid.faces, of_solid(solid), normals, solid.texture)


def _normals(solid: Solid) -> np.ndarray:
    """Of its vertices: the mean of the triangles about each, larger ones counting more."""
    first, second, third = (solid.vertices[solid.faces[:, corner]] for corner in range(3))
    edges = np.cross(second - first, third - first)
    normals = np.zeros_like(solid.vertices)
    for corner in range(3):
        np.add.at(normals, solid.faces[:, corner], edges)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals


def _curve_file(path: Path, points: np.ndarray, radius_mm: float | np.ndarray) -> str:
    rows = np.column_stack((points, np.broadcast_to(radius_mm, len(points))))
    np.savetxt(path, rows, fmt="%.6f")
    return str(path)
