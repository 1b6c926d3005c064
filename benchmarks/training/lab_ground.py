"""What a lab scene lies on: pads with slits, phantom skin, flesh, cloth and what is printed there, under random lights.

Colours are display values, blue first, 0 to 255, as float32; lengths are pixels.
"""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

THREAD, NEEDLE, INSTRUMENT, GROUND = 0, 1, 2, 3
Image = Float32[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]
Curve = Float64[np.ndarray, "n 2"]
Box = tuple[slice, slice]
Colour = tuple[float, float, float]
Ranges = tuple[tuple[float, float], ...]
FONTS = (0, 1, 2, 3, 4, 6, 7)


@dataclasses.dataclass(frozen=True)
class Lists:
    """What scenes are drawn from: one of two lists without anything in common. Angles in degrees."""

    pads: tuple[Colour, ...]
    threads: tuple[Colour, ...]
    light_angles: Ranges
    shaft_angles: Ranges
    jaw_angles: Ranges
    wrist_angles: Ranges
    slit_turns: Ranges


TRAIN = Lists(
    pads=(
        *((150, 180, 222), (190, 205, 235), (120, 150, 205), (200, 205, 215), (90, 120, 170), (150, 150, 215)),
        *((225, 230, 235), (110, 130, 200), (60, 75, 115), (165, 190, 205), (130, 165, 225), (175, 185, 205)),
    ),
    threads=(
        *((22, 20, 20), (45, 42, 40), (175, 75, 30), (120, 50, 25), (150, 40, 110), (120, 45, 75), (70, 130, 40)),
        *((40, 35, 165), (60, 60, 215), (235, 238, 240), (205, 215, 222), (140, 140, 140), (165, 170, 120)),
        *((150, 185, 205), (110, 150, 170), (90, 120, 140), (200, 150, 90), (95, 165, 90), (75, 80, 85)),
    ),
    light_angles=((-180, 95), (140, 180)),
    shaft_angles=((-180, -150), (-130, -50), (-30, 30), (50, 130), (150, 180)),
    jaw_angles=((-1, 36), (48, 85)),
    wrist_angles=((-70, -42), (-30, 26), (38, 70)),
    slit_turns=((0, 62), (85, 180)),
)
SEALED = Lists(
    pads=((140, 175, 190), (165, 165, 235), (75, 95, 140), (205, 220, 222), (135, 140, 185), (105, 140, 190)),
    threads=(
        *((32, 28, 36), (150, 95, 45), (135, 60, 95), (95, 140, 65), (55, 45, 190), (220, 225, 220), (120, 128, 132)),
        *((130, 168, 188), (170, 160, 140), (190, 120, 70)),
    ),
    light_angles=((96, 139),),
    shaft_angles=((-149, -131), (-49, -31), (31, 49), (131, 149)),
    jaw_angles=((37, 47),),
    wrist_angles=((-41, -31), (27, 37)),
    slit_turns=((63, 84),),
)


GROUNDS = "pad", "phantom", "flesh", "cloth", "dark"
GROUND_SHARES = 3 / 9, 2 / 9, 2 / 9, 1 / 9, 1 / 9


@dataclasses.dataclass
class Canvas:
    """The picture so far, the light on each of its pixels and how much of it each class covers."""

    image: Image
    light: Image
    covers: Float32[np.ndarray, "3 h w"]
    light_xy: tuple[float, float]
    """Towards the light, in the image plane: its length is the slope of shadows."""
    ground: Colour
    slits: list[Curve]


@dataclasses.dataclass
class Surface:
    """What one material shows before light falls on it."""

    albedo: Image
    height: Plane
    gloss: float
    sharpness: float


def one_of(rng: np.random.Generator, ranges: Ranges) -> float:
    """A number from one of the ranges, each as likely as it is long."""
    lengths = np.array([high - low for low, high in ranges])
    low, high = ranges[int(rng.choice(len(ranges), p=lengths / lengths.sum()))]
    return float(rng.uniform(low, high))


def field(rng: np.random.Generator, shape: tuple[int, int], rows: float, columns: float | None = None) -> Plane:
    """Smooth noise of about unit deviation whose features are so many pixels large."""
    cells = int(shape[0] / rows) + 4, int(shape[1] / (columns or rows)) + 4
    coarse = rng.standard_normal(cells, dtype=np.float32)
    fine = int(cells[1] * (columns or rows)) + 1, int(cells[0] * rows) + 1
    top, left = (int(rng.integers(0, max(fine[1 - axis] - shape[axis], 0) + 1)) for axis in (0, 1))
    big = cv2.resize(coarse, fine, interpolation=cv2.INTER_CUBIC)[top : top + shape[0], left : left + shape[1]]
    return 1.4 * big


def step(values: Plane, low: float, high: float) -> Plane:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((values - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def soft(image: np.ndarray, sigma: float) -> np.ndarray:
    """Blurred; large blurs are made on a smaller image, since they show no detail."""
    shrink = max(int(sigma / 3), 1)
    if shrink == 1:
        return cv2.GaussianBlur(image, (0, 0), max(sigma, 0.05))
    size = image.shape[1], image.shape[0]
    small = cv2.resize(image, (size[0] // shrink + 1, size[1] // shrink + 1), interpolation=cv2.INTER_AREA)
    return cv2.resize(cv2.GaussianBlur(small, (0, 0), sigma / shrink), size, interpolation=cv2.INTER_LINEAR)


def lay(canvas: Canvas, box: Box, colour: np.ndarray, alpha: Plane, kind: int, is_lit: bool = True) -> None:
    """Blend a layer into the canvas; the class on top owns what it covers."""
    cover = alpha[..., None]
    canvas.image[box] += cover * (colour * (canvas.light[box] if is_lit else 1) - canvas.image[box])
    canvas.covers[:, *box] *= 1 - alpha
    if kind != GROUND:
        canvas.covers[kind][box] += alpha


def darken(canvas: Canvas, mask: UInt8[np.ndarray, "h w"], sigma: float, strength: float) -> None:
    """Soft shadow of a mask that was drawn where it falls."""
    left, top, width, height = cv2.boundingRect(mask)
    if width == 0:
        return
    margin = int(3 * sigma) + 2
    box = np.s_[max(top - margin, 0) : top + height + margin, max(left - margin, 0) : left + width + margin]
    canvas.image[box] *= 1 - strength * soft(mask[box].astype(np.float32) / 255, sigma)[..., None]


def make_ground(rng: np.random.Generator, shape: tuple[int, int], lists: Lists, ground: str | None = None) -> Canvas:
    """A lit ground, with no thread, needle or instrument yet.

    Args:
        ground: one of GROUNDS; drawn, if it is None.
    """
    light, towards = _light(rng, shape, lists)
    drawn = str(rng.choice(list(GROUNDS), p=GROUND_SHARES))
    kind = drawn if ground is None else ground
    surface = _surface(rng, shape, kind, lists)
    quad = _quad(rng, shape)
    slits = _cut(rng, surface, quad, lists, kind) if rng.random() < {"pad": 0.9, "flesh": 0.5}.get(kind, 0.35) else []
    _print(rng, surface)
    if kind != "dark" and rng.random() < 0.5:
        around = str(rng.choice(["cloth", "dark", "dark", "paper"]))
        _put_on(rng, surface, _surface(rng, shape, around, lists), quad)
    image = _shaded(rng, surface, towards) * light
    image += _glints(rng, surface)[..., None] * light
    image *= rng.uniform(70, 235) / max(float(np.percentile(image[::7, ::7], 97)), 20.0) if kind != "dark" else 1
    usual = tuple(float(value) for value in np.median(surface.albedo[::9, ::9].reshape(-1, 3), axis=0))
    covers = np.zeros((3, *shape), np.float32)
    return Canvas(image, light, covers, towards, (usual[0], usual[1], usual[2]), slits)


def _light(rng: np.random.Generator, shape: tuple[int, int], lists: Lists) -> tuple[Image, tuple[float, float]]:
    """Light on each pixel, and the direction in the image where most comes from."""
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float32) / shape[1]
    kind, total = str(rng.choice(["scope", "scope", "side", "two"])), np.zeros(shape, np.float32)
    angle = np.deg2rad(one_of(rng, lists.light_angles))
    if kind != "side":
        across, down = rng.normal(0.5, 0.12), shape[0] / shape[1] * rng.normal(0.5, 0.12)
        far = np.hypot(columns - across, (rows - down) * rng.uniform(0.8, 1.5)) / rng.uniform(0.3, 1.0)
        total += rng.uniform(0.8, 1.35) * np.exp(-(far ** rng.uniform(1.6, 4.0)))
    if kind != "scope":
        slope = rng.uniform(0, 0.9) * (np.cos(angle) * (columns - 0.5) + np.sin(angle) * (rows - 0.4))
        side = rng.uniform(0.5, 1.15) * np.clip(1 + slope, 0.1, 2)
        if rng.random() < 0.5:
            shade = step(field(rng, shape, rng.uniform(150, 400)), 0.3, 0.3 + rng.uniform(0.12, 1.5))
            side = side * (1 - rng.uniform(0.2, 0.6) * shade)
        total = total * 0.6 + side if kind == "two" else side
    tint = rng.normal(1, 0.04, 3).astype(np.float32)
    slope = rng.uniform(0.05, 0.3) if kind == "scope" else rng.uniform(0.3, 1.0)
    return total[..., None] * tint, (float(slope * np.cos(angle)), float(slope * np.sin(angle)))


def _surface(rng: np.random.Generator, shape: tuple[int, int], kind: str, lists: Lists) -> Surface:
    base = np.array(lists.pads[int(rng.integers(len(lists.pads)))]) * rng.normal(1, 0.04) * rng.normal(1, 0.02, 3)
    height = 0.3 * field(rng, shape, rng.uniform(2.5, 6)) * rng.uniform(0, 0.6) + field(rng, shape, 120) * 5
    gloss, sharpness = rng.uniform(0, 0.35), rng.uniform(0.1, 0.3)
    mottle = field(rng, shape, rng.uniform(60, 200)) * rng.uniform(0.01, 0.07)
    if kind == "phantom":
        base = np.array((120, 140, 205)) * rng.normal(1, 0.08, 3) * rng.uniform(0.5, 1.15)
        height += _folds(rng, shape)
    elif kind == "flesh":
        return _flesh(rng, shape)
    elif kind in ("cloth", "paper"):
        base = 255 * np.clip(rng.choice([0.15, 0.35, 0.8]) + rng.normal(0, 0.15, 3), 0.03, 0.95)
        if rng.random() < 0.5:
            base = np.array([(150, 80, 25), (40, 45, 200), (110, 120, 50), (60, 45, 40)][int(rng.integers(4))])
        if kind == "cloth":
            height += _weave(rng, shape) + 0.6 * _folds(rng, shape)
        gloss = rng.uniform(0, 0.08)
    elif kind == "dark":
        base, gloss = rng.uniform(2, 28) * rng.normal(1, 0.08, 3), rng.uniform(0, 0.05)
    albedo = base.astype(np.float32) * (1 + mottle + 0.01 * field(rng, shape, 3))[..., None]
    if kind != "dark" and rng.random() < 0.5:
        _speckle(rng, albedo)
    return Surface(albedo, height, gloss, sharpness)


def _folds(rng: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Rounded folds with creases between them, along one direction that bends."""
    angle = rng.uniform(0, np.pi)
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    wide = rng.uniform(70, 260)
    along = (np.cos(angle) * columns + np.sin(angle) * rows) / wide + 0.5 * field(rng, shape, rng.uniform(150, 400))
    return (rng.uniform(0.15, 0.45) * wide * np.abs(np.sin(along)) * step(field(rng, shape, 250), -1.2, 0.8)).astype(
        np.float32
    )


def _weave(rng: np.random.Generator, shape: tuple[int, int]) -> Plane:
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    pitch, turn = rng.uniform(2.2, 7), rng.uniform(-0.4, 0.4)
    bend = field(rng, shape, 200)
    warp = np.sin(2 * np.pi * (columns + turn * rows) / pitch + bend)
    return (rng.uniform(0, 0.8) * warp * np.sin(2 * np.pi * (rows - turn * columns) / pitch + bend)).astype(np.float32)


def _flesh(rng: np.random.Generator, shape: tuple[int, int]) -> Surface:
    """Red, pink and yellow, in patches, wrinkled and wet."""
    colours = np.array([(70, 70, 190), (130, 140, 215), (130, 190, 220), (45, 40, 120), (160, 185, 225), (90, 95, 170)])
    first, second, third = (
        (colours[at] * rng.normal(1, 0.06, 3)).astype(np.float32) for at in rng.choice(len(colours), 3, replace=False)
    )
    second, third = (first + rng.uniform(0.2, 1.0) * (other - first) for other in (second, third))
    albedo = first + (second - first) * step(field(rng, shape, rng.uniform(40, 200)), -0.8, 0.8)[..., None]
    albedo += (third - albedo) * step(field(rng, shape, 30) + field(rng, shape, 120), 0.5, 2.5)[..., None]
    albedo *= (1 + rng.uniform(0.02, 0.12) * field(rng, shape, 4, rng.uniform(4, 20)))[..., None]
    height = np.zeros(shape, np.float32)
    for size in (6, 13, 28, 70):
        height += rng.uniform(0.01, 0.07) * size * field(rng, shape, size, size * rng.uniform(0.6, 2.5))
    if rng.random() < 0.6:
        _veins(rng, albedo)
    return Surface(np.clip(albedo, 3, 250), height, rng.uniform(0.2, 1.0), rng.uniform(0.06, 0.16))


def _veins(rng: np.random.Generator, albedo: Image) -> None:
    mask = np.zeros(albedo.shape[:2], np.uint8)
    for _ in range(int(rng.integers(2, 9))):
        path = wandering(rng, rng.uniform(0, 1, 2) * albedo.shape[1::-1], rng.uniform(60, 400), 0.02)
        cv2.polylines(mask, [as_drawn(path)], False, 255, int(rng.integers(1, 5)), cv2.LINE_AA, 4)
    alpha = soft(mask.astype(np.float32) / 255, rng.uniform(0.7, 2.0))[..., None]
    albedo *= 1 - rng.uniform(0.15, 0.5) * alpha * np.array((1.0, 1.1, 0.5), np.float32)


def _speckle(rng: np.random.Generator, albedo: Image) -> None:
    """Dust, pores and flakes."""
    for tone in (rng.uniform(0, 60), rng.uniform(200, 255)):
        mask = np.zeros(albedo.shape[:2], np.uint8)
        for column, row in rng.integers(0, 2000, (int(rng.integers(20, 400)), 2)):
            cv2.circle(mask, (int(column), int(row)), int(rng.integers(0, 3) * rng.random()), 255, -1)
        albedo += soft(mask.astype(np.float32) / 255, 0.6)[..., None] * (tone - albedo) * rng.uniform(0.3, 0.9)


def as_drawn(points: np.ndarray) -> np.ndarray:
    """Points as OpenCV draws them with shift 4: 1/16 px."""
    return np.rint(16 * np.clip(points, -3000, 6000)).astype(np.int32).reshape(-1, 1, 2)


def wandering(rng: np.random.Generator, start: np.ndarray, length: float, bend: float) -> Curve:
    """A smooth random curve, one point a pixel; `bend` is the usual curvature, 1 / px."""
    count = max(int(length), 8)
    knots = max(int(length * bend / rng.uniform(1.0, 3.0)), 2) + 3
    turns = bend * rng.standard_normal(knots) + rng.normal(0, 0.5 * bend)
    curvature = cv2.GaussianBlur(np.interp(np.linspace(0, knots - 1, count), np.arange(knots), turns)[None], (0, 0), 4)
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(curvature[0])
    return start + np.cumsum(np.column_stack((np.cos(heading), np.sin(heading))), axis=0)


def _quad(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Corners of a pad in the image: a turned rectangle seen aslant."""
    size = shape[1] * rng.uniform(0.5, 1.2)
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size / 2 * (1, rng.uniform(0.6, 0.95))
    square = square * (1 + rng.normal(0, 0.08, (4, 1)))
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    return square @ turn.T * (1, rng.uniform(0.7, 1)) + rng.normal(0.5, 0.15, 2) * shape[1::-1]


def _cut(rng: np.random.Generator, surface: Surface, quad: np.ndarray, lists: Lists, kind: str) -> list[Curve]:
    """Slits and cuts with their lips; returns their middles."""
    shape = surface.height.shape
    to_image = cv2.getPerspectiveTransform(
        np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32), quad.astype(np.float32)
    )
    width, curves = rng.uniform(1.5, 9) * shape[1] / 960, list[Curve]()
    for _ in range(int(rng.choice((1, 1, 2, 3, 4)))):
        angle, bend = np.deg2rad(one_of(rng, lists.slit_turns)), rng.choice([0, 0, 1]) * rng.normal(0, 0.25)
        at, length, gap = rng.uniform(0.2, 0.8, 2), rng.uniform(0.15, 0.6), rng.uniform(0.09, 0.25)
        along, across = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
        for number in range(int(rng.integers(1, 5))):
            t = np.linspace(-0.5, 0.5, 60)[:, None]
            path = at + number * gap * across + length * (t * along + bend * (t * t - 0.08) * across)
            curves.append(cv2.perspectiveTransform(path[None].astype(np.float64), to_image)[0])
    mask, is_cut = np.zeros(shape, np.uint8), kind == "flesh" or rng.random() < 0.4
    for curve in curves:
        _open(rng, mask, curve, width, is_cut)
    far = cv2.distanceTransform(255 - mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    if kind == "pad" and rng.random() < 0.6:
        # a block with steep sides, as on training pads
        half, steep = rng.uniform(2.5, 9) * width, rng.uniform(1.1, 1.7)
        surface.height += rng.uniform(0.3, 1.0) * half * step(-far, -steep * half, -half)
    else:
        lip = rng.uniform(2, 5) * width
        surface.height += rng.choice([0, 0.3, 1]) * rng.uniform(0.5, 1.2) * lip * step(-far, -2 * lip, -lip)
    surface.height -= rng.uniform(0, 1.2) * width * step(-far, -width, 0)
    within = (12, 12, 16), (12, 12, 16), (25, 25, 120), (60, 70, 190), (40, 50, 70)
    inside = np.array(within[int(rng.integers(len(within)))])
    alpha = soft(mask.astype(np.float32) / 255, rng.uniform(0.5, 1.5))[..., None]
    inner = (inside * (1 + 0.3 * field(rng, shape, 5))[..., None]).astype(np.float32)
    if rng.random() < 0.3:
        _stain(rng, surface, curves, width)
    surface.albedo += alpha * (np.minimum(inner, surface.albedo * 0.9) - surface.albedo)
    return curves


def _open(rng: np.random.Generator, mask: np.ndarray, curve: Curve, width: float, is_cut: bool) -> None:
    """Draw a slit of one width, or a cut that narrows towards its ends."""
    if not is_cut:
        cv2.polylines(mask, [as_drawn(curve)], False, 255, max(round(width), 1), cv2.LINE_AA, 4)
        return
    t = np.linspace(-1, 1, len(curve))
    wide = width * rng.uniform(0.6, 2.0) * (1 - t**2) * (1 + 0.25 * rng.standard_normal(6)[np.arange(len(curve)) // 10])
    normal = np.gradient(curve, axis=0)[:, ::-1] * (1, -1)
    normal /= np.linalg.norm(normal, axis=1)[:, None] + 1e-9
    sides = np.concatenate((curve + normal * wide[:, None] / 2, (curve - normal * wide[:, None] / 2)[::-1]))
    cv2.fillPoly(mask, [as_drawn(sides)], 255, cv2.LINE_AA, 4)


def _stain(rng: np.random.Generator, surface: Surface, curves: list[Curve], width: float) -> None:
    """Red ink along slits, as on training pads: streaky, wider than they are."""
    mask = np.zeros(surface.height.shape, np.uint8)
    for curve in curves:
        cv2.polylines(mask, [as_drawn(curve)], False, 255, max(round(3 * width), 3), cv2.LINE_AA, 4)
    worn = step(field(rng, surface.height.shape, 3, 14) + field(rng, surface.height.shape, 40), -1.5, 0.5)
    alpha = (soft(mask.astype(np.float32) / 255, 1.2) * worn * rng.uniform(0.5, 0.95))[..., None]
    surface.albedo += alpha * (np.array((60, 50, 190), np.float32) * rng.uniform(0.6, 1.1) - surface.albedo)


def _print(rng: np.random.Generator, surface: Surface) -> None:
    """Letters, printed or raised, lines of ink, rulers and holes."""
    shape = surface.height.shape
    for _ in range(int(rng.choice([0, 0, 1, 2]))):
        letters = _letters(rng, shape)
        if rng.random() < 0.5:
            surface.height += rng.uniform(1, 3) * soft(letters, rng.uniform(1, 2)) * rng.choice([-1, 1])
        else:
            surface.albedo += letters[..., None] * (rng.uniform(0, 255, 3).astype(np.float32) - surface.albedo)
    for _ in range(int(rng.choice([0, 0, 0, 1, 3]))):
        mask = np.zeros(shape, np.uint8)
        path = wandering(rng, rng.uniform(0.1, 0.9, 2) * shape[::-1], rng.uniform(80, 700), rng.choice([0.0005, 0.006]))
        cv2.polylines(mask, [as_drawn(path)], False, 255, int(rng.integers(1, 9)), cv2.LINE_AA, 4)
        worn = step(field(rng, shape, 4) + field(rng, shape, 25), -rng.uniform(0.5, 3), 0.2)
        ink = np.array([(60, 30, 20), (120, 30, 70), (30, 30, 35), (150, 70, 30), (40, 40, 180)][int(rng.integers(5))])
        alpha = (soft(mask.astype(np.float32) / 255, 0.8) * worn * rng.uniform(0.3, 0.95))[..., None]
        surface.albedo += alpha * (ink.astype(np.float32) - surface.albedo)
    for _ in range(int(rng.choice([0, 0, 0, 2, 6]))):
        at = rng.uniform(0, 1, 2) * shape[::-1]
        hole = np.zeros(shape, np.uint8)
        cv2.circle(hole, (int(at[0]), int(at[1])), int(rng.uniform(2, 9)), 255, -1, cv2.LINE_AA)
        surface.albedo *= 1 - rng.uniform(0.5, 0.95) * soft(hole.astype(np.float32) / 255, 1)[..., None]


def _letters(rng: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Random letters, digits and strokes somewhere in the image, turned; 0 to 1."""
    drawn = np.zeros(shape, np.uint8)
    text = "".join(rng.choice(list("ABCDEFGHKLMNOPRSTUVXYZabcdegmnorst0123456789-./"), int(rng.integers(1, 10))))
    size, bold = rng.uniform(0.5, 3), int(rng.integers(1, 7))
    place = int(shape[1] * 0.3), shape[0] // 2
    cv2.putText(drawn, text, place, int(rng.choice(FONTS)), size, 255, bold, cv2.LINE_AA)
    turn = cv2.getRotationMatrix2D((shape[1] / 2, shape[0] / 2), rng.uniform(0, 360), rng.uniform(0.7, 1.1))
    turn[:, 2] += rng.normal(0, 0.25, 2) * shape[::-1]
    turn[0] *= rng.choice([-1, 1])
    turn[0, 2] += shape[1] * (turn[0, 2] < 0 and turn[0, 0] < 0)
    return cv2.warpAffine(drawn, turn, shape[::-1]).astype(np.float32) / 255


def _put_on(rng: np.random.Generator, surface: Surface, around: Surface, quad: np.ndarray) -> None:
    """Leave the surface within a border (straight or bent) alone; beyond it is what is around, in its shadow."""
    shape = surface.height.shape
    mask = np.zeros(shape, np.uint8)
    if rng.random() < 0.6:
        cv2.fillPoly(mask, [as_drawn(quad)], 255, cv2.LINE_AA, 4)
    else:
        blob = field(rng, shape, shape[1] * rng.uniform(0.3, 0.7)) + rng.uniform(0, 0.03) * field(rng, shape, 40)
        mask = (255 * step(blob, -0.8, -0.8 + 0.01)).astype(np.uint8)
    far, inside = (
        cv2.distanceTransform(part, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        for part in (255 - mask, np.where(mask > 127, mask, 0))
    )
    thick = rng.uniform(4, 25)
    alpha = soft(mask.astype(np.float32) / 255, 0.7)
    around.albedo *= 1 - rng.uniform(0.2, 0.8) * step(-far, -rng.uniform(1, 4) * thick, 0)[..., None]
    surface.albedo[:] = around.albedo + alpha[..., None] * (surface.albedo - around.albedo)
    surface.height[:] = around.height + alpha * (surface.height + thick * step(inside, 0, 1.5 * thick) - around.height)


def _shaded(rng: np.random.Generator, surface: Surface, towards: tuple[float, float]) -> Image:
    """The surface's colours by its slopes, with what it mirrors."""
    shape = surface.height.shape
    height = soft(surface.height, rng.uniform(0.6, 1.2))
    across = cv2.Sobel(height, cv2.CV_32F, 1, 0, scale=0.125)
    down = cv2.Sobel(height, cv2.CV_32F, 0, 1, scale=0.125)
    unit = np.array(towards) / np.hypot(*towards)
    lit = 1 - rng.uniform(0.5, 0.9) * (unit[0] * across + unit[1] * down)
    hollow = np.clip(soft(height, 9) - height, 0, 12)
    lit = np.clip(lit, 0.12, 1.7) * (1 - rng.uniform(0.02, 0.06) * hollow)
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float32) / shape[1]
    at, near = rng.uniform(0.2, 0.8, 2), rng.uniform(0.3, 2.0)
    slope = np.hypot(across + near * (columns - at[0]), down + near * (rows - at[1] * shape[0] / shape[1]))
    mirrored = 255 * surface.gloss * np.exp(-((slope / surface.sharpness) ** 2))
    return surface.albedo * lit[..., None] + mirrored[..., None]


def _glints(rng: np.random.Generator, surface: Surface) -> Plane:
    """Small blobs and streaks of mirrored lamps on what is glossy or wet."""
    shape = surface.height.shape
    if surface.gloss < 0.12 or rng.random() < 0.4:
        return np.zeros(shape, np.float32)
    size = np.exp(rng.uniform(np.log(3), np.log(30)))
    blobs = field(rng, shape, size, size * rng.uniform(0.4, 3)) + 0.5 * field(rng, shape, 0.4 * size)
    where = step(field(rng, shape, 200), rng.uniform(-0.5, 1), 1.5)
    return rng.uniform(80, 300) * step(blobs, 2, 2 + rng.uniform(0.2, 1.5)) * where


def save(path: Path, image: np.ndarray) -> None:
    """Write a PNG."""
    path.write_bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 2])[1].tobytes())
