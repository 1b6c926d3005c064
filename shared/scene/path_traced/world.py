"""A field as Mitsuba's scene. Its shapes are named, so that a ray's hit tells what it met."""

import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from shared.scene.path_traced.engine import engine, reinterpreted
from shared.scene.path_traced.field import Field
from shared.scene.path_traced.ground import Ground, grid_axes
from shared.scene.path_traced.solids import METALS, Needle, Solid
from shared.scene.path_traced.splines import end_directions
from shared.scene.path_traced.strands import DYES, Strand

BRAID_PITCH_MM = 0.8
LAMP = "lamp"
GROUND, STRAND, NEEDLE, TOOL = "ground", "strand", "needle", "tool"


def build(field: Field) -> Any:
    """Mitsuba's scene of the field."""
    mi = engine()
    parts: dict[str, Any] = {"type": "scene", GROUND: _ground(field.ground), LAMP: _lamp()}
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
            "base_color": _bitmap(ground.albedo),
            "roughness": _bitmap(ground.roughness[..., None]),
            "specular": 0.45,
            "clearcoat": _bitmap(ground.film[..., None]),
            "clearcoat_gloss": 0.92,
        },
    }
    return _mesh(GROUND, points, faces, material, normals.reshape(-1, 3), np.column_stack((u.ravel(), 1.0 - v.ravel())))


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


def _bitmap(values: np.ndarray) -> dict[str, Any]:
    bitmap = engine().Bitmap(np.ascontiguousarray(values, dtype=np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}


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
            "bsdf": {"type": "twosided", "inside": {"type": "diffuse", "reflectance": _colour(DYES[strand.dye])}},
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
            **_bitmap(np.clip(cv2.GaussianBlur(pattern, (3, 3), 0), 0.0, 0.95)),
            "wrap_mode": "repeat",
            "to_uv": engine().ScalarTransform4f().scale([pitches, 3.0, 1.0]),
        },
        "roughness": 0.34,
        "specular": 0.5,
    }


def _needle(needle: Needle, folder: Path) -> dict[str, Any]:
    points = needle.curve.control_points
    taper = np.clip((len(points) - 1 - np.arange(len(points))) / (0.25 * len(points)), 0.0, 1.0)
    return {
        "type": "bsplinecurve",
        "filename": _curve_file(folder / "needle.txt", points, needle.radius_mm * taper),
        "bsdf": _metal("bright", 1.0, 0.22),
    }


def _solid(solid: Solid, name: str) -> Any:
    first, second, third = (solid.vertices[solid.faces[:, corner]] for corner in range(3))
    edges = np.cross(second - first, third - first)
    normals = np.zeros_like(solid.vertices)
    for corner in range(3):
        np.add.at(normals, solid.faces[:, corner], edges)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    material = {"type": "twosided", "inside": _metal(solid.metal, solid.metallic, 0.32)}
    return _mesh(name, solid.vertices, solid.faces, material, normals)


def _metal(metal: str, metallic: float, roughness: float) -> dict[str, Any]:
    return {
        "type": "principled",
        "base_color": {"type": "rgb", "value": list(METALS[metal])},
        "metallic": metallic,
        "roughness": roughness,
        "specular": 0.5,
    }


def _colour(value: tuple[float, float, float]) -> dict[str, Any]:
    return {"type": "rgb", "value": list(value)}


def _curve_file(path: Path, points: np.ndarray, radius_mm: float | np.ndarray) -> str:
    rows = np.column_stack((points, np.broadcast_to(radius_mm, len(points))))
    np.savetxt(path, rows, fmt="%.6f")
    return str(path)
