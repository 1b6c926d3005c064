"""The outline of an instrument before a camera: points where a line of sight touches shaft, wrist or a finger.

Each part is a tube along a line, of elliptical section with half-axes w along x and t along y. With d the direction of
its axis, and b at right angles to d and to the line of sight, it is touched (to first order in size over distance) at

    p ± (w² (b·x) x + t² (b·y) y) / h - (ρ² / D) e,     h² = w² (b·x)² + t² (b·y)²,

e leading from the camera to the axis at the distance D, at right angles to d, and ρ² = h²: a thick shaft near the lens
shows less than half of itself.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.tool_tracker.tubes import FINGER, SHAFT, Tube
from schemas.messages import RectifiedStereo

TIP, END = range(3, 5)
RIM = 40
NEAREST_M = 0.012
MASK_SHARE = 0.25
PLACES = 100
"""More than an edge has."""


@dataclass(frozen=True, eq=False)
class Outline:
    """Where an outline is expected in one eye.

    Fields:
        points_camera: in the left camera's frame, metres.
        px, normal: pixels, and the unit normal in the image, outward.
        part: SHAFT, WRIST, FINGER, TIP or END.
        place: which place of the instrument it is, the same in both eyes.
    """

    points_camera: Float64[np.ndarray, "n 3"]
    px: Float64[np.ndarray, "n 2"]
    normal: Float64[np.ndarray, "n 2"]
    part: Int64[np.ndarray, "n"]
    place: Int64[np.ndarray, "n"]

    def only(self, kept: Bool[np.ndarray, "n"]) -> "Outline":
        """Some of its points."""
        return Outline(self.points_camera[kept], self.px[kept], self.normal[kept], self.part[kept], self.place[kept])


def outline(camera: RectifiedStereo, parts: tuple[Tube, ...], eye_x: float) -> Outline:
    """The outline of parts in the eye at (eye_x, 0, 0): what is in view, and no other part covers. Metres."""
    sides = [_sides(part, eye_x) for part in parts]
    polygons = [_polygon(camera, part, pair, eye_x) for part, pair in zip(parts, sides, strict=True)]
    covers = [_mask(camera, polygon) for polygon in polygons]
    found = list[Outline]()
    for i, part in enumerate(parts):
        others = np.max([cover for j, cover in enumerate(covers) if j != i], axis=0)
        pieces = [*_along(camera, part, sides[i], eye_x), *_across(camera, part, eye_x)]
        for j, piece in enumerate(pieces):
            free = (piece.points_camera[:, 2] > NEAREST_M) & _in_view(camera, piece.px, 3.0)
            numbered = dataclasses.replace(piece, place=piece.place + PLACES * (3 * i + j))
            found.append(numbered.only(free & ~_covered(others, piece.px)))
    fields = [field.name for field in dataclasses.fields(Outline)]
    return Outline(*(np.concatenate([getattr(one, name) for one in found]) for name in fields))


def silhouette(
    camera: RectifiedStereo, parts: tuple[Tube, ...], eye_x: float, size: tuple[int, int]
) -> UInt8[np.ndarray, "k l"]:
    """What the parts cover in an eye's image of that size (rows, columns), as 0 and 1."""
    mask = np.zeros(size, np.uint8)
    for part in parts:
        corners = size[1] / camera.image_width * _polygon(camera, part, _sides(part, eye_x), eye_x)
        cv2.fillPoly(mask, [np.rint(16 * corners).clip(-1 << 20, 1 << 20).astype(np.int32)], 1, cv2.LINE_8, 4)
    return mask


def _along(
    camera: RectifiedStereo, part: Tube, sides: tuple[np.ndarray, np.ndarray], eye_x: float
) -> tuple[Outline, Outline]:
    """Both edges of a part."""
    axis_px = _pixels(camera, part.places, eye_x)
    one, other = (_edge(camera, side, axis_px, part.part, eye_x, np.gradient) for side in sides)
    return one, other


def _across(camera: RectifiedStereo, part: Tube, eye_x: float) -> tuple[Outline, ...]:
    """The end of a finger, or of the shaft."""
    if part.part == FINGER:
        return (_tip(camera, part, eye_x),)
    return (_far_rim(camera, part, eye_x),) if part.part == SHAFT else ()


def _tip(camera: RectifiedStereo, finger: Tube, eye_x: float) -> Outline:
    """The end of a finger, whose outline runs across it."""
    along = finger.places[-1] - finger.places[0]
    tip = finger.places[-1] + 0.0003 * along / np.linalg.norm(along)
    at = _pixels(camera, np.stack((finger.places[-3], tip)), eye_x)
    way = at[1:] - at[:1]
    length = float(np.linalg.norm(way))
    found = Outline(tip[None], at[1:], way / max(length, 1e-9), np.full(1, TIP), np.zeros(1, np.int64))
    return found.only(np.array([length > 4.0]))


def _far_rim(camera: RectifiedStereo, shaft: Tube, eye_x: float) -> Outline:
    """The far half of the circle in which the shaft ends, which is its outline where it points away from the lens."""
    circle, u = _rim(shaft)
    axis = _pixels(camera, shaft.places[1::-1], eye_x)
    way = axis[1] - axis[0]
    middle = np.broadcast_to(_pixels(camera, circle, eye_x).mean(axis=0), (RIM, 2))
    found = _edge(camera, circle, middle, END, eye_x, _around)
    away = circle.mean(axis=0) @ u >= eye_x * u[0]
    return found.only(away & (found.normal @ way > 0.25 * np.linalg.norm(way)))


def _edge(
    camera: RectifiedStereo,
    points: Float64[np.ndarray, "n 3"],
    inside_px: Float64[np.ndarray, "n 2"],
    part: int,
    eye_x: float,
    slope: Callable[..., np.ndarray],
) -> Outline:
    """Points along an edge, their normals away from what is inside of it."""
    at = _pixels(camera, points, eye_x)
    tangent = slope(at, axis=0)
    normal = np.column_stack((tangent[:, 1], -tangent[:, 0]))
    normal *= np.sign(np.einsum("ij,ij->i", normal, at - inside_px))[:, None]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return Outline(points, at, normal, np.full(len(at), part), np.arange(len(at)))


def _around(at: Float64[np.ndarray, "n 2"], axis: int) -> Float64[np.ndarray, "n 2"]:
    """The slope along a closed line."""
    return np.roll(at, -1, axis) - np.roll(at, 1, axis)


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
