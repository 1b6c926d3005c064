"""Instruments of lab scenes: the Large Needle Driver from its meshes and simpler ones, drawn with a depth buffer.

Lengths are millimetres, x right, y down, z away from the camera; colours are display values, blue first.
"""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, Int64

from benchmarks.training.lab_ground import (
    INSTRUMENT,
    Box,
    Canvas,
    Curve,
    Lists,
    darken,
    field,
    lay,
    one_of,
    soft,
)
from shared.rendering.path_traced.meshes import (
    FORK_TO_PIN_MM,
    HANGS_AT,
    JAW_MM,
    JAW_TO_WRIST,
    JAWS_AT,
    WRIST_TO_FORK,
    driver_parts,
    turned_about,
)
from shared.rendering.path_traced.solids import Solid as TracedSolid

SHAFT, STEEL, WRIST, JAW_1, JAW_2, PLASTIC = range(6)


@dataclasses.dataclass(frozen=True)
class Solid:
    """Triangles: corners where they are (t, 3, 3), their normals, corners in their own part's frame, and the part."""

    corners: Float64[np.ndarray, "t 3 3"]
    normals: Float64[np.ndarray, "t 3 3"]
    own: Float64[np.ndarray, "t 3 3"]
    parts: Int64[np.ndarray, "t"]

    def moved(self, turn: np.ndarray, shift: np.ndarray | float = 0.0, part: int | None = None) -> "Solid":
        """Turned, then shifted."""
        parts = self.parts if part is None else np.full(len(self.parts), part)
        return Solid(self.corners @ turn.T + shift, self.normals @ turn.T, self.own, parts)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """An instrument as it lies in the image: its layer, the nearer jaw alone, and where the jaws meet."""

    box: Box
    colour: np.ndarray
    alpha: np.ndarray
    near_jaw: np.ndarray
    grip: Curve
    """(2, 2): the jaws' tip and a point towards their root, px."""
    px_per_mm: float


def joined(solids: list[Solid]) -> Solid:
    """All of them as one."""
    return Solid(
        *(np.concatenate([getattr(solid, name) for solid in solids]) for name in ("corners", "normals", "own", "parts"))
    )


def load_meshes(folder: Path) -> dict[str, Solid]:
    """The driver's parts, mm.

    Raises:
        SceneError: where one is absent or no such mesh; the text names it.
    """
    return {name: _of_steel(part) for name, part in driver_parts(folder).items()}


def _of_steel(part: TracedSolid) -> Solid:
    corners, normals = (np.asarray(values).reshape(-1, 3, 3) for values in (part.vertices, part.normals))
    return Solid(corners, normals, corners, np.full(len(corners), STEEL))


def rod(path: np.ndarray, radii: np.ndarray, part: int, sides: int = 28) -> Solid:
    """A closed tube around a path (n, 3) with radii (n, 2) across and aslant."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    first = np.cross(along, (0.31, 0.2, 0.93) if abs(along[0, 2]) < 0.9 else (0.0, 1, 0))
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(along, first)
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[None, :, None]
    outward = np.cos(angle) * first[:, None] + np.sin(angle) * second[:, None]
    ring = path[:, None] + np.cos(angle) * first[:, None] * radii[:, :1, None]
    ring = ring + np.sin(angle) * second[:, None] * radii[:, 1:, None]
    ring = np.concatenate((path[:1, None] + 0 * ring[:1], ring, path[-1:, None] + 0 * ring[:1]))
    outward = np.concatenate((-along[:1, None] + 0 * outward[:1], outward, along[-1:, None] + 0 * outward[:1]))
    own = np.stack(np.broadcast_arrays(np.arange(len(ring))[:, None], np.arange(sides)[None], 0.0), 2)
    quads = [
        [
            np.stack((v[:-1], np.roll(v, -1, 1)[:-1], v[1:]), 2).reshape(-1, 3, 3),
            np.stack((np.roll(v, -1, 1)[:-1], np.roll(v, -1, 1)[1:], v[1:]), 2).reshape(-1, 3, 3),
        ]
        for v in (ring, outward, own)
    ]
    corners, normals, own = (np.concatenate(pair) for pair in quads)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_turned = (facing * normals.mean(axis=1)).sum(axis=1) < 0
    corners[is_turned], normals[is_turned] = corners[is_turned][:, ::-1], normals[is_turned][:, ::-1]
    return Solid(corners, normals, own, np.full(len(corners), part))


def needle_driver(rng: np.random.Generator, meshes: dict[str, Solid], lists: Lists) -> tuple[Solid, np.ndarray]:
    """A Large Needle Driver along z at random joints, and where its jaws' tip and root are (2, 3)."""
    jaw = np.deg2rad(one_of(rng, lists.jaw_angles))
    yaw, pitch = np.deg2rad([one_of(rng, lists.wrist_angles) for _ in range(2)])
    finger = _finger(rng, meshes["tip_006"])
    parts: list[Solid] = []
    for part, half, flip in ((JAW_1, jaw / 2, 0.0), (JAW_2, -jaw / 2, np.pi)):
        turn = JAW_TO_WRIST @ turned_about(2, yaw + half) @ turned_about(1, flip)
        parts.append(finger.moved(turn, JAWS_AT, part))
    pin = meshes["wrist_yaw_0091"]
    parts.append(meshes["wrist_pitch_0091_archived"].moved(np.eye(3), part=WRIST))
    parts.append(pin.moved(np.diag((1, 1, 1.28)), JAWS_AT * (1, 1, 0)))
    hang = turned_about(0, pitch) @ WRIST_TO_FORK
    shift = np.array((0, 0, FORK_TO_PIN_MM)) - hang @ HANGS_AT
    distal = joined(parts).moved(hang, shift)
    tips = np.array([(0, JAW_MM, 0), (0, 2.0, 0)]) @ (JAW_TO_WRIST @ turned_about(2, yaw)).T + JAWS_AT
    across = meshes["roll_4162_yaw"].moved(turned_about(1, np.pi / 2), np.array((-4.01, 0, FORK_TO_PIN_MM)))
    wheels = [
        rod(
            np.array([(x, 0.0, FORK_TO_PIN_MM), (x + 0.6, 0, FORK_TO_PIN_MM)]),
            np.full((2, 2), rng.uniform(2, 2.7)),
            STEEL,
        )
        for x in (-2.9, -2.0, 1.4, 2.3)
    ]
    return joined([distal, meshes["roll_4162"], across, *wheels, _shaft(rng, 4.15)]), tips @ hang.T + shift


def _finger(rng: np.random.Generator, tip: Solid) -> Solid:
    """The jaw, as thick as real ones are (its mesh is flat), narrowing and rounded towards its tip."""
    corners = tip.corners.copy()
    x, y, z = corners[..., 0], corners[..., 1], corners[..., 2]
    is_finger = y > 2.9
    z[is_finger] = (z[is_finger] + 0.3) * rng.uniform(1.8, 3.0)
    narrow = 1 - rng.uniform(0, 0.45) * np.clip((y - 3) / 7.6, 0, 1)
    narrow = narrow * np.sqrt(1 - 0.8 * np.clip((y - 9.8) / 0.8, 0, 1) ** 2)
    x[is_finger], z[is_finger] = (x * narrow)[is_finger], (z * narrow)[is_finger]
    return Solid(corners, tip.normals, corners, tip.parts)


def _shaft(rng: np.random.Generator, radius: float) -> Solid:
    along = np.concatenate(([0.0, -0.01, -0.4], np.linspace(-1.5, -170, 60)))
    path = np.column_stack((0 * along, 0 * along, along))[::-1]
    radii = np.full((len(path), 2), radius * rng.uniform(0.96, 1.0))
    return rod(path, radii, SHAFT, 40)


def plain_tool(rng: np.random.Generator, lists: Lists) -> tuple[Solid, np.ndarray]:
    """Forceps, scissors or a holder of rods and cones, along z; and its tips' middle and root (2, 3)."""
    length, thick = rng.uniform(6, 28), rng.uniform(0.5, 1.7)
    opening, bend = np.deg2rad(max(one_of(rng, lists.jaw_angles) / 2.5, 0)), rng.normal(0, 0.12)
    t = np.linspace(0, 1, 24)
    solids: list[Solid] = []
    for side, part in ((-1, JAW_1), (1, JAW_2)):
        bow = side * (0.06 * length * np.sin(np.pi * t) + 0.55 * thick * (1 - 0.6 * t))
        x = bow + np.sin(side * opening / 2) * length * t
        path = np.column_stack((x, bend * length * t**2, length * t * np.cos(opening / 2)))
        taper = thick * (1 - rng.uniform(0.2, 0.8) * t)
        taper[-1] *= 0.6
        solids.append(rod(path, np.column_stack((taper * rng.uniform(0.6, 1.4), taper)), part, 16))
    radius = thick * rng.uniform(1.3, 3.5)
    z = np.array([1.5, 0.8, 0, -2, -8, -8.2, -12])
    wide = radius * np.array([0.35, 0.8, 0.95, 1, 1, *rng.uniform(0.8, 1.2, 2)])
    path = np.column_stack((0 * z, 0 * z, z))[::-1]
    solids.append(rod(path, np.column_stack((wide, wide * rng.uniform(0.6, 1)))[::-1], STEEL))
    part = int(rng.choice([SHAFT, STEEL, PLASTIC]))
    shaft = _shaft(rng, radius * rng.uniform(0.7, 1.1)).moved(np.eye(3), np.array((0, 0, -11.9)), part)
    return joined([*solids, shaft]), np.array([(0, bend * length, length), (0, 0, 0.2 * length)])


def draw_instrument(
    rng: np.random.Generator, canvas: Canvas, meshes: dict[str, Solid], lists: Lists, tip_px: np.ndarray
) -> Drawn | None:
    """Lay one instrument into the canvas whose jaws end about there; nothing if it stays outside."""
    shape = canvas.light.shape[:2]
    solid, grip = needle_driver(rng, meshes, lists) if rng.random() < 0.7 else plain_tool(rng, lists)
    scale = shape[1] / 960 * np.exp(rng.uniform(np.log(6), np.log(27)))
    focal = rng.uniform(0.9, 1.7) * shape[1]
    aim = np.deg2rad(one_of(rng, lists.shaft_angles))
    away = rng.uniform(-0.15, 0.9)
    z = np.array((np.cos(aim), np.sin(aim), away)) / np.sqrt(1 + away**2)
    x = np.cross((0.0, 0, 1), z)
    x /= np.linalg.norm(x)
    turn = np.column_stack((x, np.cross(z, x), z)) @ turned_about(2, rng.uniform(0, 2 * np.pi))
    depth = focal / scale
    place = np.array((*(tip_px - np.array(shape[::-1]) / 2) / scale, depth)) - turn @ grip[0]
    ends = grip @ turn.T + place
    grip_px = focal * ends[:, :2] / ends[:, 2:] + np.array(shape[::-1]) / 2
    drawn = _rendered(rng, canvas, solid.moved(turn, place), focal, grip_px, scale)
    if drawn is None:
        return None
    _shade_ground(rng, canvas, drawn)
    lay(canvas, drawn.box, drawn.colour, drawn.alpha, INSTRUMENT)
    return drawn


def _shade_ground(rng: np.random.Generator, canvas: Canvas, drawn: Drawn) -> None:
    mask = np.zeros(canvas.light.shape[:2], np.uint8)
    mask[drawn.box] = 255 * drawn.alpha
    high = rng.uniform(0.5, 8) * drawn.px_per_mm
    shift = -np.array(canvas.light_xy) * high
    thrown = cv2.warpAffine(mask, np.array([(1, 0, shift[0]), (0, 1, shift[1])]), mask.shape[::-1])
    darken(canvas, thrown, 1.5 + 0.25 * high * rng.uniform(0.5, 1.5), rng.uniform(0.2, 0.75))


def _rendered(
    rng: np.random.Generator, canvas: Canvas, solid: Solid, focal: float, grip: Curve, scale: float
) -> Drawn | None:
    """Depth-buffered pixels of the solid, shaded."""
    shape = canvas.light.shape[:2]
    depth = np.maximum(solid.corners[..., 2], 1.0)
    flat = focal * solid.corners[..., :2] / depth[..., None] + np.array(shape[::-1]) / 2
    one, two = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    faces = (area < -1e-9) & (solid.corners[..., 2].min(axis=1) > 5)
    which, row, column, weights = _filled(flat[faces], shape)
    which = np.flatnonzero(faces)[which]
    own = np.einsum("nk,nkc->nc", weights, solid.own[which])
    keep = _without_gaps_of_teeth(rng, own, solid.parts[which])
    which, row, column, weights, own = which[keep], row[keep], column[keep], weights[keep], own[keep]
    if len(which) < 50:
        return None
    z = (weights * depth[which]).sum(axis=1)
    order, flat_at = np.argsort(-z), row * shape[1] + column
    seen = np.full(shape[0] * shape[1], -1)
    seen[flat_at[order]] = order
    seen = seen[seen >= 0]
    margin = 3
    box = (
        slice(max(row.min() - margin, 0), row.max() + margin + 1),
        slice(max(column.min() - margin, 0), column.max() + margin + 1),
    )
    size = canvas.light[box].shape[:2]
    at = (row[seen] - box[0].start) * size[1] + column[seen] - box[1].start
    normal = np.einsum("nk,nkc->nc", weights[seen], solid.normals[which[seen]])
    normal /= np.linalg.norm(normal, axis=1)[:, None] + 1e-9
    parts = solid.parts[which[seen]]
    mask, planes = np.zeros(size[0] * size[1], np.float32), np.zeros((size[0] * size[1], 3), np.float32)
    mask[at] = 1
    planes[at] = _colours(rng, canvas, normal, own[seen], parts, at, size)
    hollow = np.zeros(size[0] * size[1], np.float32)
    hollow[at] = z[seen] - z[seen].min() + 1
    mask, planes = (
        mask.reshape(size),
        planes.reshape(*size, 3) * _hollows(hollow.reshape(size), mask.reshape(size), scale),
    )
    near = JAW_1 if _mean(z[seen], parts == JAW_1) < _mean(z[seen], parts == JAW_2) else JAW_2
    jaw = np.zeros(size[0] * size[1], np.float32)
    jaw[at[parts == near]] = 1
    sigma = rng.uniform(0.45, 0.7) if rng.random() < 0.7 else rng.uniform(0.7, 2.2)
    alpha = np.clip(soft(mask, sigma), 0, 1)
    colour = soft(planes * mask[..., None], sigma) / np.maximum(alpha, 1e-3)[..., None]
    return Drawn(box, colour, alpha, np.clip(soft(jaw.reshape(size), sigma), 0, 1) * (alpha > 0), grip, scale)


def _mean(values: np.ndarray, where: np.ndarray) -> float:
    return float(values[where].mean()) if where.any() else np.inf


def _filled(flat: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels within triangles (t, 3, 2): the triangle, row, column and the corners' weights (n, 3) of each."""
    low = np.clip(np.ceil(flat[..., 1].min(axis=1)), 0, shape[0]).astype(int)
    high = np.clip(np.floor(flat[..., 1].max(axis=1)), -1, shape[0] - 1).astype(int)
    which, row = _spans(low, high)
    x, y = flat[which, :, 0], flat[which, :, 1]
    rise = np.roll(y, -1, 1) - y
    share = (row[:, None] - y) / np.where(np.abs(rise) < 1e-9, 1e-9, rise)
    met = np.where((share >= -1e-9) & (share <= 1 + 1e-9), x + share * (np.roll(x, -1, 1) - x), np.nan)
    left = np.clip(np.ceil(np.fmin.reduce(met, axis=1)), 0, shape[1])
    right = np.clip(np.floor(np.fmax.reduce(met, axis=1)), -1, shape[1] - 1)
    line, column = _spans(np.nan_to_num(left, nan=1).astype(int), np.nan_to_num(right, nan=0).astype(int))
    which, row = which[line], row[line]
    a, b, c = (flat[which, at] for at in range(3))
    p = np.column_stack((column, row))
    area = _cross(b - a, c - a)
    first, second = _cross(b - p, c - p) / area, _cross(c - p, a - p) / area
    return which, row, column, np.column_stack((first, second, 1 - first - second))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _spans(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All whole numbers from low to high of each span, and of which span each is."""
    lengths = np.maximum(high - low + 1, 0)
    which = np.repeat(np.arange(len(low)), lengths)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(lengths) - lengths, lengths) + low[which]


def _without_gaps_of_teeth(rng: np.random.Generator, own: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """False where teeth leave a gap: along the inner face of the jaws, which is at x = 0 of their frame."""
    pitch, deep = rng.uniform(0.3, 0.6), rng.uniform(0.05, 0.3)
    jagged = deep * np.abs(2 * np.mod(own[:, 1] / pitch, 1) - 1)
    is_toothed = ((parts == JAW_1) | (parts == JAW_2)) & (own[:, 1] > rng.uniform(4, 6))
    return ~(is_toothed & (np.abs(own[:, 0]) < jagged))


def _hollows(depth: np.ndarray, mask: np.ndarray, scale: float) -> np.ndarray:
    """Darker where the neighbourhood is nearer, (h, w, 1)."""
    sigma = max(0.8 * scale, 2.0)
    around = soft(depth, sigma) / np.maximum(soft(mask, sigma), 0.05)
    return np.clip(1 - 0.35 * np.maximum(depth - around, 0), 0.25, 1)[..., None]


def _colours(
    rng: np.random.Generator,
    canvas: Canvas,
    normal: np.ndarray,
    own: np.ndarray,
    parts: np.ndarray,
    at: np.ndarray,
    size: tuple[int, int],
) -> np.ndarray:
    """What each seen pixel shows (n, 3): steel mirrors an invented surrounding, shafts are black with a streak."""
    worn = (1 + rng.uniform(0.01, 0.12) * field(rng, size, rng.uniform(1.5, 4), rng.uniform(3, 12))).ravel()[at]
    worn = worn * (1 + rng.uniform(0, 0.15) * field(rng, size, 25)).ravel()[at]
    tint = np.array((1.0, 1.0, 1.0)) * rng.normal(1, 0.05, 3)
    around = mirrored_surrounding(rng, np.array(canvas.ground))
    look = np.clip(31.5 + 30 * normal[:, :2], 0, 63).astype(int)
    colour = around[look[:, 1], look[:, 0]] * tint * worn[:, None]
    for part in (JAW_1, JAW_2):
        colour[parts == part] *= rng.uniform(0.6, 1.1)
    pitch = rng.uniform(0.3, 0.6)
    stripes = 0.55 + 0.45 * np.sin(2 * np.pi * own[:, 1] / pitch) * np.sign(np.sin(2 * np.pi * own[:, 2] / pitch) + 0.6)
    is_inner = ((parts == JAW_1) | (parts == JAW_2)) & (np.abs(own[:, 0]) < 0.12) & (own[:, 1] > 4)
    colour[is_inner] *= np.clip(stripes, 0.1, 1)[is_inner, None] * rng.uniform(0.5, 1)
    _engrave(rng, colour, own, parts)
    dull = np.array((1.0, 1.0, 1.0)) * rng.uniform(3, 45) * rng.normal(1, 0.06, 3)
    if rng.random() < 0.15:
        dull = rng.uniform(20, 210) * rng.normal(1, 0.2, 3)
    streak = np.zeros(len(parts))
    for _ in range(int(rng.integers(1, 4))):
        centre, wide = rng.uniform(-0.7, 0.7, 2), rng.uniform(0.05, 0.35)
        off = np.linalg.norm((normal[:, :2] - centre) * (1, rng.choice([0, 1])), axis=1)
        streak += rng.uniform(5, 120) * np.exp(-((off / wide) ** 2))
    is_dull = (parts == SHAFT) | (parts == PLASTIC)
    shade = 0.35 + 0.75 * np.clip(-normal[:, 2], 0, 1)
    plain = (dull * shade[:, None] + streak[:, None]) * (0.5 + 0.5 * worn[:, None])
    return np.where(is_dull[:, None], plain, colour)


def mirrored_surrounding(rng: np.random.Generator, ground: np.ndarray) -> np.ndarray:
    """What steel shows by its normal's x and y (64, 64, 3): dark, with lamps, the ground and bands."""
    y, x = np.mgrid[:64, :64] / 31.5 - 1
    grey = rng.uniform(15, 70) + rng.uniform(20, 110) * np.clip(1 - np.hypot(x, y), 0, 1)
    grey = grey + rng.uniform(10, 60) * field(rng, (64, 64), rng.uniform(6, 20)).astype(float)
    for _ in range(int(rng.integers(1, 5))):
        angle, at = rng.uniform(0, np.pi), rng.uniform(-0.8, 0.8)
        far = np.abs(np.cos(angle) * x + np.sin(angle) * y - at) / rng.uniform(0.04, 0.25)
        grey += rng.uniform(-60, 170) * np.exp(-(far**4))
    for _ in range(int(rng.integers(1, 4))):
        spot = np.hypot(x - rng.normal(0, 0.35), y - rng.normal(0, 0.35)) / rng.uniform(0.08, 0.35)
        grey += rng.uniform(80, 300) * np.exp(-(spot**3))
    below = np.clip(np.hypot(x, y) - rng.uniform(0.3, 0.8), 0, 1) * rng.uniform(0, 2)
    return np.clip(grey, 2, 300)[..., None] + below[..., None] * (ground - np.clip(grey, 2, 300)[..., None]) * 0.8


def _engrave(rng: np.random.Generator, colour: np.ndarray, own: np.ndarray, parts: np.ndarray) -> None:
    """Letters, rings and screws on the flat sides of the wrist, darker or brighter."""
    plate = np.zeros((96, 160), np.uint8)
    text = "".join(rng.choice(list("SiISDVLND0146789"), int(rng.integers(1, 5))))
    at, size = (int(rng.uniform(20, 80)), 66), rng.uniform(0.8, 1.6)
    cv2.putText(plate, text, at, int(rng.choice((0, 2, 3))), size, 255, 3, cv2.LINE_AA)
    if rng.random() < 0.6:
        cv2.circle(plate, (int(rng.uniform(60, 100)), 48), int(rng.uniform(6, 14)), 255, 3, cv2.LINE_AA)
    cv2.circle(plate, (20, 48), int(rng.uniform(8, 13)), 200, int(rng.integers(2, 5)), cv2.LINE_AA)
    is_flat = (parts == WRIST) & ((own[:, 2] < 0.6) | (own[:, 2] > 5.7))
    u = np.clip((own[is_flat, 0] + 5.5) * 12.3, 0, 159).astype(int)
    v = np.clip((own[is_flat, 1] + 3.0) * 16, 0, 95).astype(int)
    colour[is_flat] *= 1 + rng.choice([-0.8, -0.6, 0.5]) * plate[v, u, None] / 255
