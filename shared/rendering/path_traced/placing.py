"""Where instruments and needles go: over the thread where they are to hide it, beside it otherwise."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, UInt8
from scipy.spatial import cKDTree

from shared.camera import project
from shared.rendering.path_traced.field import Field
from shared.rendering.path_traced.rod import Pinned
from shared.rendering.path_traced.solids import SIDES, Needle, Solid, instrument, needle_from, pose_towards, silhouette
from shared.rendering.path_traced.splines import Strand, end_directions, sampled
from shared.rendering.surface import depth_at_points

HIDDEN_SHARE = (0.30, 0.50)
"""The paper's scenario hides a large portion of the thread: 30 % of its length or more, in either eye."""

TIP_SHARE = 0.12
STRAY_SHARE = 0.12
NEAR_TIPS_MM = 4.0
CLEAR_OF_MESH_MM = 1.0
AT_ONCE = 20_000
ATTEMPTS = 300

Maker = Callable[[Float64[np.ndarray, "3"], np.random.Generator], list[Solid]]
"""Makes an instrument, drawn at random, whose jaws end at a point."""


def drawn_instrument(tip: Float64[np.ndarray, "3"], rng: np.random.Generator) -> list[Solid]:
    """A simple instrument whose jaws end there; all else is drawn."""
    pose = pose_towards(tip, rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.25, 0.9), rng.uniform(0.0, np.pi))
    metal = str(rng.choice(("dark", "steel", "bright"), p=(0.5, 0.35, 0.15)))
    opening = float(rng.choice((0.0, 1.0)) * rng.uniform(0.1, 0.9))
    return instrument(pose, float(rng.uniform(2.4, 4.2)), opening, metal, rng)


def occluders(field: Field, rng: np.random.Generator, made: Maker = drawn_instrument) -> list[Solid]:
    """One or two instruments over the middle of the first strand, or none where no place was found."""
    points, _ = sampled(field.strands[0].curve, 0.5)
    pixels = project(field.camera, points)
    for attempt in range(ATTEMPTS):
        centre = points[int(rng.uniform(0.3, 0.7) * len(points))]
        tools: list[Solid] = []
        for _ in range(1 + (attempt % 3 == 2)):
            aside = np.array([*rng.uniform(-14.0, 14.0, 2), -rng.uniform(10.0, 26.0)])
            tools += made(centre + aside, rng)
        covers = [silhouette(field.camera, tools, eye) for eye in (0.0, field.camera.baseline)]
        shares = [hidden(cover, seen) for cover, seen in zip(covers, pixels, strict=True)]
        if min(shares) < HIDDEN_SHARE[0] + 0.01 or max(shares) > HIDDEN_SHARE[1]:
            continue
        # it hides the middle: where the thread goes under and comes out again is there to be seen
        tips = round(TIP_SHARE * len(points))
        ends = [np.vstack((seen[:tips], seen[-tips:])) for seen in pixels]
        covered = [hidden(cover, end) for cover, end in zip(covers, ends, strict=True)]
        if max(covered) == 0 and clear_of(tools, field):
            return tools
    return []


def bystanders(
    field: Field, rng: np.random.Generator, count: int, above_mm: float, made: Maker = drawn_instrument
) -> list[Solid]:
    """Instruments in view that hide little of any strand; fewer where there is no room."""
    camera = field.camera
    seen = [project(camera, sampled(strand.curve, 0.5)[0])[0] for strand in field.strands]
    depth = float(np.median(field.ground.surface.depth_mm))
    kept: list[Solid] = []
    for _ in range(count):
        for _ in range(40):
            pixel = rng.uniform(0.1, 0.9, 2) * (camera.image_width, camera.image_height)
            z = depth - above_mm - rng.uniform(0.0, 22.0)
            x, y = (pixel - (camera.cx_px, camera.cy_px)) * z / camera.fx_px
            tools = made(np.array([x, y, z]), rng)
            cover = silhouette(camera, tools)
            most = max((hidden(cover, pixels) for pixels in seen), default=0.0)
            if most < STRAY_SHARE and clear_of(tools, field) and 0.01 < float((cover > 0).mean()) < 0.25:
                kept += tools
                break
    return kept


def needle_on(field: Field, rng: np.random.Generator) -> Needle | None:
    """A needle at the end of the first strand that stays above the ground and within the image, or None."""
    strand = field.strands[0]
    end = strand.curve.at(np.array([float(strand.curve.spans)]))[0]
    outward = end_directions(strand.curve)[1]
    for _ in range(60):
        needle = _arc_at(end, outward, rng.uniform(-np.pi, np.pi), strand.radius_mm, rng)
        if _lies_above(field, needle, 0.1) and _within(field, sampled(needle.curve, 0.2)[0]):
            return needle
    return None


def _arc_at(
    end: Float64[np.ndarray, "3"],
    outward: Float64[np.ndarray, "3"],
    roll: float,
    thread_radius_mm: float,
    rng: np.random.Generator,
) -> Needle:
    """A needle that goes on where a thread ends; at roll 0 and π its arc lies in the image plane."""
    side = np.cross(outward, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cos(roll) * side + np.sin(roll) * np.cross(outward, side)
    arc_radius, arc = rng.uniform(5.0, 9.0), np.radians(rng.uniform(135.0, 190.0))
    return needle_from(end, outward, up, arc_radius, arc, max(1.4 * thread_radius_mm, rng.uniform(0.25, 0.45)))


def _lies_above(field: Field, needle: Needle, deepest_mm: float) -> bool:
    points, _ = sampled(needle.curve, 0.2)
    gap = depth_at_points(field.ground.surface, points[:, :2]) - points[:, 2] - needle.radius_mm
    return bool(gap.min() > -deepest_mm and np.median(gap) < 9.0)


def with_ending(field: Field, pinned: Pinned, rng: np.random.Generator) -> Field:
    """The field with what holds the end of a thread: a needle that lies there, or the jaws of an instrument."""
    end = pinned.strand.curve.at(np.array([float(pinned.strand.curve.spans)]))[0]
    # threads are brought nearer where they would pass through each other, and their ends with them
    end = end + field.strands[-1].curve.control_points[0] - pinned.strand.curve.control_points[0]
    if pinned.ending == "needle" and field.needle is None:
        for _ in range(30):
            roll = rng.choice((0.0, np.pi)) + rng.normal(0.0, 0.35)
            needle = _arc_at(end, pinned.direction, roll, pinned.strand.radius_mm, rng)
            if _lies_above(field, needle, 0.3):
                return replace(field, needle=needle)
    if pinned.ending == "gripper":
        for _ in range(30):
            pose = pose_towards(end, rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.25, 0.8), rng.uniform(0.0, np.pi))
            held = replace(pose, tip=end - 2.5 * pose.towards_shaft)
            tools = instrument(held, float(rng.uniform(2.4, 4.0)), 0.0, str(rng.choice(("dark", "steel"))), rng)
            cover = silhouette(field.camera, tools)
            pixels = project(field.camera, sampled(field.strands[-1].curve, 0.5)[0])[0]
            if above_ground(tools, field) and hidden(cover, pixels) < STRAY_SHARE:
                return replace(field, tools=[*field.tools, *tools])
    return field


def hidden(cover: UInt8[np.ndarray, "h w"], pixels: Float64[np.ndarray, "n 2"]) -> float:
    """The share of these pixels that are covered."""
    rows, columns = cover.shape
    column = np.clip(np.rint(pixels[:, 0]).astype(int), 0, columns - 1)
    row = np.clip(np.rint(pixels[:, 1]).astype(int), 0, rows - 1)
    return float((cover[row, column] > 0).mean())


def clear_of(tools: list[Solid], field: Field) -> bool:
    """Whether no tool dips into the ground or passes through a thread."""
    return above_ground(tools, field) and all(_apart(tools, strand) for strand in field.strands)


def above_ground(tools: list[Solid], field: Field) -> bool:
    """Whether no tool dips into the ground."""
    for tool in tools:
        # corners of a mesh are the same point several times
        points = tool.vertices if tool.is_lofted else np.unique(np.round(tool.vertices, 2), axis=0)
        seen = points[points[:, 2] > 0]
        for some in np.array_split(seen, 1 + len(seen) // AT_ONCE):
            if len(some) and (depth_at_points(field.ground.surface, some[:, :2]) - some[:, 2]).min() < 0.5:
                return False
    return True


def _apart(tools: list[Solid], strand: Strand) -> bool:
    points, _ = sampled(strand.curve, 0.5)
    for tool in tools:
        if not tool.is_lofted:
            # no edge of a mesh is longer than this bridges
            corners = tool.vertices[np.unique(tool.faces)]
            nearest, _ = cKDTree(corners).query(points)
            if np.min(nearest) < strand.radius_mm + CLEAR_OF_MESH_MM:
                return False
            continue
        centres = tool.vertices[:-2].reshape(-1, SIDES, 3)
        middle, reach = (
            centres.mean(axis=1),
            np.linalg.norm(centres - centres.mean(axis=1, keepdims=True), axis=2).max(axis=1),
        )
        start, way = middle[:-1], np.diff(middle, axis=0)
        share = np.einsum("nsd,sd->ns", points[:, None] - start, way) / np.maximum((way**2).sum(axis=1), 1e-12)
        foot = start + np.clip(share, 0.0, 1.0)[..., None] * way
        gap = np.linalg.norm(points[:, None] - foot, axis=2) - np.maximum(reach[:-1], reach[1:])
        if gap.min() < strand.radius_mm + 0.3:
            return False
    return True


def _within(field: Field, points: Float64[np.ndarray, "n 3"]) -> bool:
    last = np.array([field.camera.image_width, field.camera.image_height]) - 6.0
    return all(bool(((pixels > 5.0) & (pixels < last)).all()) for pixels in project(field.camera, points))
