"""The outline of an instrument before a camera: points where a line of sight touches shaft, wrist or a finger.

Each part is a tube along a line, of elliptical section with half-axes w along x and t along y. With d the direction of
its axis, and b at right angles to d and to the line of sight, it is touched (to first order in size over distance) at

    p ± (w² (b·x) x + t² (b·y) y) / h - (ρ² / D) e,     h² = w² (b·x)² + t² (b·y)²,

e leading from the camera to the axis at the distance D, at right angles to d, and ρ² = h²: a thick shaft near the lens
shows less than half of itself. Shapes: the Large Needle Driver's, in metres (shared/kinematics/psm.py).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from schemas.messages import RectifiedStereo
from shared.kinematics.psm import FINGER_M

WRIST_M = 0.0091
SHAFT, WRIST, FINGER, TIP, END = range(5)
RIM = 40
NEAREST_M = 0.012
MASK_SHARE = 0.25


Gathered = tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray], list[np.ndarray]]


@dataclass(frozen=True)
class Shape:
    """Half-axes of an instrument's parts, metres; `shaft_m` is how much of the shaft is looked at."""

    shaft_radius: float = 0.0042
    shaft_m: float = 0.07
    finger_half_width: float = 0.0019
    finger_half_thickness: float = 0.00085


DRIVER = Shape()
"""The Large Needle Driver."""


@dataclass(frozen=True, eq=False)
class Tube:
    """A part: places along its axis, its two half-axes there, and the directions that these have."""

    part: int
    places: Float64[np.ndarray, "k 3"]
    wide: Float64[np.ndarray, "k"]
    thick: Float64[np.ndarray, "k"]
    wide_way: Float64[np.ndarray, "3"]
    thick_way: Float64[np.ndarray, "3"]

    def moved(self, T: Float64[np.ndarray, "4 4"]) -> "Tube":
        """The same elsewhere."""
        R = T[:3, :3]
        places = self.places @ R.T + T[:3, 3]
        return Tube(self.part, places, self.wide, self.thick, R @ self.wide_way, R @ self.thick_way)


@dataclass(frozen=True, eq=False)
class Outline:
    """Where an outline is expected in one eye.

    Fields:
        points_camera: in the left camera's frame, metres.
        px, normal: pixels, and the unit normal in the image, outward.
        part: SHAFT, WRIST, FINGER or TIP.
    """

    points_camera: Float64[np.ndarray, "n 3"]
    px: Float64[np.ndarray, "n 2"]
    normal: Float64[np.ndarray, "n 2"]
    part: Int64[np.ndarray, "n"]

    def only(self, kept: Bool[np.ndarray, "n"]) -> "Outline":
        """Some of its points."""
        return Outline(self.points_camera[kept], self.px[kept], self.normal[kept], self.part[kept])


def shaft_and_pin(T_base_tool: Float64[np.ndarray, "4 4"]) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """The shaft's end and the jaw's pin in the base's frame."""
    pin, axis = T_base_tool[:3, 3], -T_base_tool[:3, 0]
    x = pin - (pin @ axis) * axis
    return pin - WRIST_M * x / np.linalg.norm(x), pin


def tubes(
    T_camera_base: Float64[np.ndarray, "4 4"],
    T_base_tool: Float64[np.ndarray, "4 4"],
    jaw_rad: float,
    shape: Shape = DRIVER,
) -> tuple[Tube, ...]:
    """The parts in the camera's frame: shaft, wrist, and two fingers that open by half the jaw's angle about x."""
    R, t = T_camera_base[:3, :3], T_camera_base[:3, 3]
    end, pin = (R @ p + t for p in shaft_and_pin(T_base_tool))
    x_tool, z_tool = R @ T_base_tool[:3, 0], R @ T_base_tool[:3, 2]
    u = end - t
    u = u / np.linalg.norm(u)
    aside = np.cross(u, x_tool)
    aside /= np.linalg.norm(aside)
    s = np.arange(0.0005, shape.shaft_m, 0.002)
    round_shaft = np.full(len(s), shape.shaft_radius)
    x = (pin - end) / np.linalg.norm(pin - end)
    k = np.linspace(0.1, 0.95, 9)
    size = shape.shaft_radius * np.interp(k, (0.0, 0.3, 1.0), (0.93, 0.8, 0.7))
    found = [
        Tube(SHAFT, end - s[:, None] * u, round_shaft, round_shaft, aside, np.cross(u, aside)),
        Tube(WRIST, end + WRIST_M * k[:, None] * x, size, size, x_tool, np.cross(x, x_tool)),
    ]
    f = np.linspace(0.35, 0.97, 10)
    taper = np.sqrt(1 - f**8) * (1 - 0.5 * f)
    for side in (-1.0, 1.0):
        half = 0.5 * jaw_rad * side
        along = np.cos(half) * z_tool - np.sin(half) * np.cross(x_tool, z_tool)
        across = np.cross(x_tool, along)
        centre = (
            pin + FINGER_M * f[:, None] * along - (side * 0.9 * shape.finger_half_thickness * taper)[:, None] * across
        )
        wide, thick = shape.finger_half_width * taper, shape.finger_half_thickness * taper
        found.append(Tube(FINGER, centre, wide, thick, x_tool, across))
    return tuple(found)


def outline(camera: RectifiedStereo, parts: tuple[Tube, ...], eye_x: float) -> Outline:
    """The outline of parts in the eye at (eye_x, 0, 0): what is in view, and no other part covers. Metres."""
    sides = [_sides(part, eye_x) for part in parts]
    polygons = [_polygon(camera, part, pair, eye_x) for part, pair in zip(parts, sides, strict=True)]
    covers = [_mask(camera, polygon) for polygon in polygons]
    points, px, normals, kinds = [], [], [], []
    for i, (part, (one, other)) in enumerate(zip(parts, sides, strict=True)):
        others = np.max([cover for j, cover in enumerate(covers) if j != i], axis=0)
        axis_px = _pixels(camera, part.places, eye_x)
        for edge in (one, other):
            at = _pixels(camera, edge, eye_x)
            tangent = np.gradient(at, axis=0)
            normal = np.column_stack((tangent[:, 1], -tangent[:, 0]))
            normal *= np.sign(np.einsum("ij,ij->i", normal, at - axis_px))[:, None]
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
            free = (edge[:, 2] > NEAREST_M) & _in_view(camera, at, 3.0) & ~_covered(others, at)
            points.append(edge[free])
            px.append(at[free])
            normals.append(normal[free])
            kinds.append(np.full(int(free.sum()), part.part))
        into = (points, px, normals, kinds)
        if part.part == FINGER:
            _add_tip(camera, part, eye_x, others, into)
        if part.part == SHAFT:
            _add_rim(camera, part, eye_x, others, into)
    return Outline(np.concatenate(points), np.concatenate(px), np.concatenate(normals), np.concatenate(kinds))


def silhouette(
    camera: RectifiedStereo, parts: tuple[Tube, ...], eye_x: float, size: tuple[int, int]
) -> UInt8[np.ndarray, "k l"]:
    """What the parts cover in an eye's image of that size (rows, columns), as 0 and 1."""
    mask = np.zeros(size, np.uint8)
    for part in parts:
        corners = size[1] / camera.image_width * _polygon(camera, part, _sides(part, eye_x), eye_x)
        cv2.fillPoly(mask, [np.rint(16 * corners).clip(-1 << 20, 1 << 20).astype(np.int32)], 1, cv2.LINE_8, 4)
    return mask


def _add_tip(camera: RectifiedStereo, finger: Tube, eye_x: float, others: np.ndarray, into: Gathered) -> None:
    """The end of a finger, whose outline runs across it."""
    along = finger.places[-1] - finger.places[0]
    tip = finger.places[-1] + 0.0003 * along / np.linalg.norm(along)
    at = _pixels(camera, np.stack((finger.places[-3], tip)), eye_x)
    way = at[1] - at[0]
    length = float(np.linalg.norm(way))
    if length > 4.0 and _in_view(camera, at[1:], 3.0)[0] and not _covered(others, at[1:])[0]:
        points, px, normals, kinds = into
        points.append(tip[None])
        px.append(at[1:])
        normals.append(way[None] / length)
        kinds.append(np.full(1, TIP))


def _add_rim(camera: RectifiedStereo, shaft: Tube, eye_x: float, others: np.ndarray, into: Gathered) -> None:
    """The far half of the circle in which the shaft ends, which is its outline where it points away from the lens."""
    circle, u = _rim(shaft)
    if circle.mean(axis=0) @ u < eye_x * u[0]:
        return
    at = _pixels(camera, circle, eye_x)
    axis = _pixels(camera, shaft.places[1::-1], eye_x)
    tangent = np.roll(at, -1, axis=0) - np.roll(at, 1, axis=0)
    normal = np.column_stack((tangent[:, 1], -tangent[:, 0]))
    normal *= np.sign(np.einsum("ij,ij->i", normal, at - at.mean(axis=0)))[:, None]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    way = axis[1] - axis[0]
    away = normal @ way > 0.25 * np.linalg.norm(way)
    free = away & (circle[:, 2] > NEAREST_M) & _in_view(camera, at, 3.0) & ~_covered(others, at)
    points, px, normals, kinds = into
    points.append(circle[free])
    px.append(at[free])
    normals.append(normal[free])
    kinds.append(np.full(int(free.sum()), END))


def _rim(shaft: Tube) -> tuple[Float64[np.ndarray, "r 3"], Float64[np.ndarray, "3"]]:
    """The circle in which the shaft ends, and the direction that it points in."""
    u = shaft.places[0] - shaft.places[1]
    u /= np.linalg.norm(u)
    turn = np.linspace(0, 2 * np.pi, RIM, endpoint=False)[:, None]
    across = np.cos(turn) * shaft.wide_way + np.sin(turn) * shaft.thick_way
    return shaft.places[0] + 0.0005 * u + shaft.wide[0] * across, u


def _polygon(
    camera: RectifiedStereo, part: Tube, sides: tuple[np.ndarray, np.ndarray], eye_x: float
) -> Float64[np.ndarray, "n 2"]:
    """What a part covers in an eye."""
    around = _pixels(camera, np.concatenate((sides[0], sides[1][::-1])), eye_x)
    if part.part != SHAFT:
        return around
    with_rim = np.concatenate((around, _pixels(camera, _rim(part)[0], eye_x)))
    return cv2.convexHull(with_rim.clip(-1e5, 1e5).astype(np.float32))[:, 0].astype(np.float64)


def _sides(part: Tube, eye_x: float) -> tuple[Float64[np.ndarray, "k 3"], Float64[np.ndarray, "k 3"]]:
    """The module's equation, for both signs."""
    sight = part.places - (eye_x, 0.0, 0.0)
    d = np.gradient(part.places, axis=0)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    e = sight - np.einsum("ij,ij->i", sight, d)[:, None] * d
    distance = np.maximum(np.linalg.norm(e, axis=1, keepdims=True), 1e-6)
    e = e / distance
    b = np.cross(d, e)
    wide, thick = (b @ part.wide_way) * part.wide**2, (b @ part.thick_way) * part.thick**2
    reach = wide[:, None] * part.wide_way + thick[:, None] * part.thick_way
    h = np.sqrt(np.maximum(np.einsum("ij,ij->i", reach, b), 1e-12))[:, None]
    toward = -np.minimum(h / distance, 0.9) * h * e
    narrowed = np.sqrt(1 - np.minimum(h / distance, 0.9) ** 2)
    return part.places + narrowed * reach / h + toward, part.places - narrowed * reach / h + toward


def _pixels(camera: RectifiedStereo, points: Float64[np.ndarray, "n 3"], eye_x: float) -> Float64[np.ndarray, "n 2"]:
    z = np.maximum(points[:, 2], 1e-3)
    u = camera.fx_px * (points[:, 0] - eye_x) / z + camera.cx_px
    return np.column_stack((u, camera.fy_px * points[:, 1] / z + camera.cy_px))


def _in_view(camera: RectifiedStereo, px: Float64[np.ndarray, "n 2"], margin: float) -> Bool[np.ndarray, "n"]:
    within = (px >= margin) & (px < (camera.image_width - margin, camera.image_height - margin))
    return within[:, 0] & within[:, 1]


def _mask(camera: RectifiedStereo, polygon: Float64[np.ndarray, "n 2"]) -> np.ndarray:
    mask = np.zeros((round(MASK_SHARE * camera.image_height), round(MASK_SHARE * camera.image_width)), np.uint8)
    corners = np.rint(16 * MASK_SHARE * polygon).clip(-1 << 20, 1 << 20).astype(np.int32)
    return cv2.fillPoly(mask, [corners], 1, cv2.LINE_8, 4)


def _covered(mask: np.ndarray, px: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
    column = np.clip(np.rint(MASK_SHARE * px[:, 0]), 0, mask.shape[1] - 1).astype(np.int64)
    row = np.clip(np.rint(MASK_SHARE * px[:, 1]), 0, mask.shape[0] - 1).astype(np.int64)
    return np.asarray(mask, dtype=bool)[row, column]
