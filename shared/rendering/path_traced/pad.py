"""Suture pads of silicone with cuts, blocks, ridges, letters and inked lines; and a phantom of plain silicone skin.

Cuts, ridges and blocks are paths on a ground's grid, which change its depth and colour. None of what is written on a
pad, printed or raised letters, lines and dots of a pen, specks, is thread.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from schemas.messages import RectifiedStereo
from shared.rendering.path_traced.flesh import vessel_cover
from shared.rendering.path_traced.ground import (
    STEP_MM,
    Grid,
    Ground,
    blended,
    empty_surface,
    grid_axes,
    raised,
    tilted,
    undulating,
)
from shared.rendering.surface import Surface, rough_field, smooth_field, smooth_step

FINE_BITS = 4
INSIDES = {"shadow": (0.035, 0.022, 0.018), "dark red": (0.12, 0.012, 0.012), "red": (0.40, 0.03, 0.035)}
"""Linear albedo within a cut, red first."""

Line = Float64[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Cut:
    """Lines of cuts in grid steps, their greatest width and depth in mm, and the colour within."""

    lines: list[Line]
    width_mm: float
    depth_mm: float
    inside: tuple[float, float, float]


def drawn_lines(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> list[Line]:
    """Where cuts run: side by side in one or two groups, or here and there; `mm` is grid steps per millimetre."""
    lines: list[Line] = []
    for _ in range(int(rng.integers(1, 3))):
        middle = rng.uniform(0.25, 0.75, 2) * (shape[1], shape[0])
        angle, length = rng.uniform(0.0, np.pi), rng.uniform(18.0, 60.0) * mm
        bend, apart = float(rng.choice((0.0, 1.0), p=(0.6, 0.4)) * rng.normal(0.0, 0.5)), rng.uniform(8.0, 20.0) * mm
        count = int(rng.integers(1, 5))
        for k in range(count):
            across = (k - 0.5 * (count - 1)) * apart
            shift = across * np.array([-np.sin(angle), np.cos(angle)])
            lines += _line(rng, middle + shift, angle, length, bend)
    for _ in range(int(rng.integers(0, 3))):
        middle = rng.uniform(0.15, 0.85, 2) * (shape[1], shape[0])
        lines += _line(rng, middle, rng.uniform(0.0, np.pi), rng.uniform(8.0, 40.0) * mm, rng.normal(0.0, 0.6))
    return lines


def _line(rng: np.random.Generator, middle: np.ndarray, angle: float, length: float, bend: float) -> list[Line]:
    """An arc, now and then with corners or a branch."""
    t = np.linspace(-0.5, 0.5, 60)
    heading = angle + bend * 2.0 * t
    if rng.uniform() < 0.06:
        heading = heading + rng.uniform(0.4, 0.9) * np.where(np.mod(np.floor(6.0 * (t + 0.5)), 2.0) > 0, 1.0, -1.0)
    steps = length / len(t) * np.column_stack((np.cos(heading), np.sin(heading)))
    points = np.cumsum(steps, axis=0)
    line = points - points.mean(axis=0) + middle
    if rng.uniform() > 0.1:
        return [line]
    start, way = line[len(line) // 2], angle + rng.choice((-1.0, 1.0)) * rng.uniform(0.6, 1.4)
    branch = start + 0.4 * length * (t[:, None] + 0.5) * np.array([np.cos(way), np.sin(way)])
    return [line, branch]


def lens_cover(shape: tuple[int, int], lines: list[Line], width: float, pointed: float) -> Grid:
    """Cover, 0 to 1, of the gap that each line opens to, as wide as that (in grid steps) at its middle."""
    image = np.zeros(shape, dtype=np.uint8)
    for line in lines:
        t = np.linspace(0.0, 1.0, len(line))
        half = 0.5 * width * (4.0 * t * (1.0 - t)) ** pointed
        along = np.gradient(line, axis=0)
        side = np.column_stack((-along[:, 1], along[:, 0])) / np.linalg.norm(along, axis=1, keepdims=True)
        edge = np.vstack((line + half[:, None] * side, (line - half[:, None] * side)[::-1]))
        fine = np.rint(edge * 2**FINE_BITS).astype(np.int32).reshape(-1, 1, 2)
        cv2.fillPoly(image, [fine], 255, cv2.LINE_AA, FINE_BITS)
    return image.astype(np.float32) / 255.0


def distance_to(shape: tuple[int, int], lines: list[Line]) -> Grid:
    """How far each point of the grid lies from the nearest line, in grid steps."""
    apart = np.full(shape, 255, dtype=np.uint8)
    for line in lines:
        cv2.polylines(apart, [np.rint(line).astype(np.int32).reshape(-1, 1, 2)], False, 0, 1, cv2.LINE_8)
    if not lines:
        return np.full(shape, float(sum(shape)), dtype=np.float32)
    return cv2.GaussianBlur(cv2.distanceTransform(apart, cv2.DIST_L2, 5), (0, 0), 0.8)


def blocks(shape: tuple[int, int], lines: list[Line], mm: float, half_mm: float, edge_mm: float) -> Grid:
    """0 to 1: raised blocks with round ends about lines, flat on top, so wide to either side."""
    apart = distance_to(shape, lines) / mm
    return smooth_step(-apart, -(half_mm + edge_mm), -half_mm)


def lips(shape: tuple[int, int], lines: list[Line], mm: float, width_mm: float, spread_mm: float) -> Grid:
    """0 to 1: what rises at either side of a cut of that width, and falls off over a distance."""
    apart = np.maximum(distance_to(shape, lines) / mm - 0.5 * width_mm, 0.0)
    return np.exp(-((apart / spread_mm) ** 2)).astype(np.float32)


def ridges(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    """0 to 1: a few moulded lines that stand out, round, wandering or straight."""
    lines: list[Line] = []
    for _ in range(int(rng.integers(1, 5))):
        middle = rng.uniform(0.1, 0.9, 2) * (shape[1], shape[0])
        length = rng.uniform(30.0, 120.0) * mm
        lines += _line(rng, middle, rng.uniform(0.0, np.pi), length, float(rng.normal(0.0, 0.5)))
    apart = distance_to(shape, lines) / mm
    return np.sqrt(np.maximum(1.0 - (apart / rng.uniform(0.8, 2.2)) ** 2, 0.0)).astype(np.float32)


def carve(
    cut: Cut, depth: Grid, albedo: Float32[np.ndarray, "h w 3"], mm: float, pointed: float
) -> tuple[Grid, Float32[np.ndarray, "h w 3"], Grid]:
    """Depth and albedo with cuts, deeper and darker towards their middle; and where cuts are, 0 to 1."""
    cover = lens_cover(depth.shape, cut.lines, cut.width_mm * mm, pointed)
    walls = cv2.distanceTransform((cover > 0.5).astype(np.uint8), cv2.DIST_L2, 5) / mm
    deep = cut.depth_mm * np.minimum(2.0 * walls / cut.width_mm, 1.0)
    deep = cv2.GaussianBlur(np.maximum(deep, 0.4 * cut.depth_mm * cover), (0, 0), max(0.12 * mm, 0.6))
    rim = np.clip(cv2.GaussianBlur(cover, (0, 0), 0.5 * mm) - cover, 0.0, 1.0)
    inside = blended(albedo * (1.0 - 0.25 * rim[..., None]), cut.inside, 0.95 * cover)
    # what is deep in a cut sees little of the light
    shade = np.exp(-deep / (0.6 * cut.depth_mm))
    inside = inside * (1.0 - cover * (1.0 - shade))[..., None]
    return (depth + deep).astype(np.float32), inside.astype(np.float32), cover


INKS = {
    "black": (0.02, 0.02, 0.025),
    "blue": (0.03, 0.05, 0.22),
    "violet": (0.10, 0.03, 0.17),
    "red": (0.42, 0.03, 0.04),
}
FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
)
LETTERS = "ABCDEFGHKLMNPRSTUVXYZ0123456789-."


def letters(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    """Cover, 0 to 1, of one or two words or numbers at any angle, thick or thin."""
    image = np.zeros(shape, dtype=np.uint8)
    for _ in range(int(rng.integers(1, 4))):
        word = "".join(rng.choice(list(LETTERS), int(rng.integers(1, 9))))
        high = rng.uniform(3.0, 12.0) * mm
        font, thick = FONTS[int(rng.integers(len(FONTS)))], max(int(high * rng.uniform(0.04, 0.16)), 1)
        scale = high / cv2.getTextSize(word, font, 1.0, thick)[0][1]
        (wide, tall), _ = cv2.getTextSize(word, font, scale, thick)
        line = np.zeros((2 * tall, wide + tall), dtype=np.uint8)
        cv2.putText(line, word, (tall // 2, int(1.5 * tall)), font, scale, 255, thick, cv2.LINE_AA)
        middle = rng.uniform(0.15, 0.85, 2) * (shape[1], shape[0])
        turn = cv2.getRotationMatrix2D((0.5 * line.shape[1], 0.5 * line.shape[0]), rng.uniform(-180.0, 180.0), 1.0)
        turn[:, 2] += middle - (0.5 * line.shape[1], 0.5 * line.shape[0])
        image = np.maximum(image, cv2.warpAffine(line, turn, shape[::-1]))
    return image.astype(np.float32) / 255.0


def pen_marks(rng: np.random.Generator, shape: tuple[int, int], mm: float, lines: list[Line]) -> Grid:
    """Cover, 0 to 1, of a pen's lines: along cuts, across them as ladders, pairs of dots, and lines on their own."""
    image = np.zeros(shape, dtype=np.uint8)
    width = max(round(rng.uniform(0.3, 1.0) * mm), 1)
    for line in lines:
        way = line[-1] - line[0]
        side = np.array([-way[1], way[0]]) / max(float(np.linalg.norm(way)), 1e-6)
        reach = rng.uniform(2.5, 8.0) * mm
        kind = str(rng.choice(("none", "ladder", "dots", "beside"), p=(0.4, 0.2, 0.2, 0.2)))
        places = line[
            :: max(round(rng.uniform(4.0, 10.0) * mm / max(float(np.linalg.norm(line[1] - line[0])), 1e-6)), 1)
        ]
        if kind == "ladder":
            for place in places:
                _stroke(image, np.vstack((place - reach * side, place + reach * side)), width)
        if kind == "dots":
            for place in (*(places - reach * side), *(places + reach * side)):
                cv2.circle(image, (int(place[0]), int(place[1])), width, 255, -1, cv2.LINE_AA)
        if kind == "beside":
            _stroke(image, line + reach * side, width)
    for _ in range(int(rng.poisson(0.8))):
        start, heading = rng.uniform(0.1, 0.9, 2) * (shape[1], shape[0]), rng.uniform(0.0, 2.0 * np.pi)
        end = start + rng.uniform(15.0, 80.0) * mm * np.array([np.cos(heading), np.sin(heading)])
        _stroke(image, np.vstack((start, end)), width)
    worn = cv2.resize(rng.uniform(0.5, 1.0, (40, 60)).astype(np.float32), shape[::-1])
    return cv2.GaussianBlur(image.astype(np.float32) / 255.0, (0, 0), 0.7) * worn


def specks(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    """Cover, 0 to 1, of dust and of holes that needles left."""
    image = np.zeros(shape, dtype=np.uint8)
    area = shape[0] * shape[1] / mm**2
    for _ in range(int(rng.poisson(min(area * rng.uniform(0.0, 0.02), 400.0)))):
        x, y = (int(value) for value in rng.uniform(0.0, 1.0, 2) * (shape[1] * 16, shape[0] * 16))
        cv2.circle(image, (x, y), int(16 * rng.uniform(0.08, 0.3) * mm), int(rng.uniform(80, 255)), -1, cv2.LINE_AA, 4)
    return image.astype(np.float32) / 255.0


def _stroke(image: np.ndarray, points: np.ndarray, width: int) -> None:
    fine = np.rint(points * 2**FINE_BITS).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(image, [fine], False, 255, width, cv2.LINE_AA, FINE_BITS)


def ink(rng: np.random.Generator) -> tuple[float, float, float]:
    """Its linear albedo, red first."""
    return INKS[str(rng.choice(list(INKS), p=(0.4, 0.2, 0.15, 0.25)))]


SKINS = {
    "beige": (0.58, 0.40, 0.27),
    "pale": (0.68, 0.52, 0.42),
    "pink": (0.60, 0.30, 0.24),
    "tan": (0.44, 0.25, 0.15),
    "brown": (0.22, 0.11, 0.07),
    "grey": (0.52, 0.48, 0.45),
}
"""Linear albedo of silicone, red first."""
TABLES = {
    "red card": (0.45, 0.02, 0.02),
    "blue drape": (0.03, 0.12, 0.26),
    "green drape": (0.03, 0.16, 0.11),
    "black cloth": (0.008, 0.008, 0.009),
    "white": (0.72, 0.72, 0.70),
    "wood": (0.34, 0.20, 0.10),
}
WIDE_VIEW_MM = 150.0
BRIDGED_MM = 0.6
MOST_TILT, MOST_BEND = 0.16, 0.12
FARTHEST = 0.15
"""Of the distance, from a phantom's top to the border of its grid: what lies deeper, the grid does not reach."""


def pad_ground(camera: RectifiedStereo, distance_mm: float, rng: np.random.Generator) -> Ground:
    """A suture pad around that distance; everything about it is drawn."""
    surface = tilted(empty_surface(camera, distance_mm, step_of(camera, distance_mm)), rng, MOST_TILT)
    surface = undulating(surface, rng, {70.0: rng.uniform(0.0, 0.8)})
    shape, mm = surface.depth_mm.shape, 1.0 / surface.step_mm
    albedo = _skin(rng, shape, mm)
    lines = drawn_lines(rng, shape, mm)
    width = float(np.exp(rng.uniform(np.log(0.3), np.log(2.4))))
    height = np.zeros(shape, dtype=np.float32)
    kind = str(rng.choice(("blocks", "lips", "flat"), p=(0.35, 0.4, 0.25)))
    if kind == "blocks":
        half = rng.uniform(2.0, 4.5)
        height += rng.uniform(1.0, 4.0) * blocks(shape, lines, mm, half, rng.uniform(0.5, 1.5))
    if kind == "lips":
        height += rng.uniform(0.3, 1.2) * lips(shape, lines, mm, width, rng.uniform(0.8, 2.5))
    if rng.uniform() < 0.35:
        height += rng.uniform(0.3, 1.5) * ridges(rng, shape, mm)
    if rng.uniform() < 0.5:
        words, way = letters(rng, shape, mm), rng.uniform()
        if way < 0.55:
            height += rng.uniform(-0.5, 1.0) * cv2.GaussianBlur(words, (0, 0), 0.25 * mm)
        else:
            albedo = blended(albedo, ink(rng), rng.uniform(0.5, 0.95) * words)
    if rng.uniform() < 0.6:
        albedo = blended(albedo, ink(rng), rng.uniform(0.4, 0.95) * pen_marks(rng, shape, mm, lines))
    albedo = blended(albedo, (0.05, 0.035, 0.03), 0.8 * specks(rng, shape, mm))
    uncut = raised(surface, -height)
    inside = INSIDES[str(rng.choice(list(INSIDES), p=(0.45, 0.3, 0.25)))]
    pointed = 0.12 if kind == "blocks" else float(rng.uniform(0.2, 0.9))
    cut = Cut(lines, width, max(float(rng.uniform(0.8, 3.0)), 0.9 * width), inside)
    depth, albedo, within = carve(cut, uncut.depth_mm, albedo, mm, pointed)
    ground = _of_silicone(rng, replace(uncut, depth_mm=depth), albedo, bridged(uncut))
    ground = replace(
        ground, roughness=ground.roughness + within * (0.9 - ground.roughness), film=(1.0 - within) * ground.film
    )
    visible_mm = camera.image_width / camera.fx_px * distance_mm
    return _on_table(rng, ground, mm) if rng.uniform() < (0.75 if visible_mm > WIDE_VIEW_MM else 0.25) else ground


def phantom_ground(camera: RectifiedStereo, distance_mm: float, rng: np.random.Generator) -> Ground:
    """Plain silicone skin, gently curved, with folds and a few veins that show through; everything is drawn."""
    surface = tilted(empty_surface(camera, distance_mm, step_of(camera, distance_mm)), rng, MOST_TILT)
    x, y = grid_axes(surface)
    angle, shift = rng.uniform(0.0, np.pi), rng.normal(0.0, 10.0)
    across = np.cos(angle) * x + np.sin(angle) * y[:, None] + shift
    half_mm = 0.5 * camera.image_width / camera.fx_px * distance_mm
    curvature = 2.0 * rng.uniform(0.02, MOST_BEND) * distance_mm / half_mm**2
    deepest = FARTHEST * distance_mm
    surface = raised(surface, deepest * np.tanh(0.5 * curvature * across**2 / deepest))
    shape, mm = surface.depth_mm.shape, 1.0 / surface.step_mm
    surface = undulating(surface, rng, {45.0: rng.uniform(0.3, 2.0), 16.0: rng.uniform(0.0, 0.25)})
    folds = np.abs(smooth_field(rng, shape, 40.0 * mm, (1.0, 2.5)))
    surface = raised(surface, float(rng.choice((0.0, 1.0)) * rng.uniform(0.5, 2.0)) * np.exp(-((folds / 0.12) ** 2)))
    albedo = _skin(rng, shape, mm)
    albedo *= 1.0 + 0.07 * rough_field(rng, shape, 25.0 * mm, 3)[..., None]
    veins = cv2.GaussianBlur(vessel_cover(rng, shape, 1.2 * mm, int(rng.poisson(2.0)), 0.3), (0, 0), 0.5 * mm)
    albedo = blended(albedo, (0.30, 0.20, 0.24), rng.uniform(0.0, 0.5) * veins)
    return _of_silicone(rng, surface, albedo, bridged(surface))


def step_of(camera: RectifiedStereo, distance_mm: float) -> float:
    """The grid's step in mm: finer than a pixel sees, and no finer than is of use."""
    return max(STEP_MM, distance_mm / camera.fx_px)


def bridged(surface: Surface) -> Surface:
    """What thread lies on: nowhere behind the surface, and without its sharpest edges."""
    smooth = cv2.GaussianBlur(surface.depth_mm, (0, 0), BRIDGED_MM / surface.step_mm)
    return replace(surface, depth_mm=np.minimum(smooth, surface.depth_mm))


def _skin(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Float32[np.ndarray, "h w 3"]:
    """Albedo of plain silicone: a colour, hardly mottled."""
    name = str(rng.choice(list(SKINS), p=(0.28, 0.2, 0.22, 0.13, 0.09, 0.08)))
    base = np.array(SKINS[name], dtype=np.float32) * np.clip(rng.normal(1.0, 0.05, 3), 0.85, 1.15).astype(np.float32)
    mottled = 0.03 * rough_field(rng, shape, 18.0 * mm, 4) + 0.015 * smooth_field(rng, shape, 0.6 * mm)
    return (base * (1.0 + mottled[..., None])).astype(np.float32)


def _of_silicone(
    rng: np.random.Generator, surface: Surface, albedo: Float32[np.ndarray, "h w 3"], carrying: Surface
) -> Ground:
    """A ground with a dull sheen and skin's fine grain."""
    shape, mm = albedo.shape[:2], 1.0 / surface.step_mm
    grain = rng.uniform(0.0, 0.007) * smooth_field(rng, shape, 0.9 * mm)
    roughness = rng.uniform(0.35, 0.65) + 0.04 * rough_field(rng, shape, 12.0 * mm, 3)
    film = np.full(shape, max(float(rng.uniform(-0.15, 0.2)), 0.0), dtype=np.float32)
    return Ground(
        raised(surface, grain),
        np.clip(albedo, 0.004, 0.9).astype(np.float32),
        np.clip(roughness, 0.25, 0.9).astype(np.float32),
        film,
        carrying,
        is_mirrored=False,
    )


def _on_table(rng: np.random.Generator, ground: Ground, mm: float) -> Ground:
    """The pad ends within the image: round edges, and a card or a drape below, which ends in another."""
    shape = ground.film.shape
    edge = _beyond(rng, shape, rng.uniform(0.25, 0.42)) / mm
    round_mm, thick = rng.uniform(1.0, 3.0), float(rng.uniform(3.0, 12.0))
    off = smooth_step(edge, 0.0, round_mm)
    names = rng.choice(list(TABLES), 2, replace=False)
    table = np.broadcast_to(np.array(TABLES[str(names[0])], dtype=np.float32), (*shape, 3))
    other = smooth_step(_beyond(rng, shape, rng.uniform(0.42, 0.6)) / mm, 0.0, 0.4)
    table = (
        blended(table, TABLES[str(names[1])], other) * (1.0 + 0.05 * rough_field(rng, shape, 2.0 * mm, 3))[..., None]
    )
    cover = smooth_step(edge, 0.7 * round_mm, round_mm)[..., None]
    plane = _plane(ground.surface) + thick

    def lowered(surface: Surface) -> Surface:
        depth = surface.depth_mm + off * (plane - surface.depth_mm)
        return replace(surface, depth_mm=depth.astype(np.float32))

    surface = lowered(ground.surface)
    return replace(
        ground,
        surface=surface,
        albedo=np.clip(ground.albedo + cover * (table - ground.albedo), 0.004, 0.9).astype(np.float32),
        roughness=(ground.roughness + cover[..., 0] * (0.75 - ground.roughness)).astype(np.float32),
        carrying=bridged(lowered(ground.bed)),
    )


def _beyond(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Grid:
    """How far each point lies outside a rectangle turned at random, in grid steps, negative within."""
    rows, columns = np.indices(shape, dtype=np.float32)
    middle = (0.5 + rng.uniform(-0.15, 0.15, 2)) * (shape[1], shape[0])
    angle = rng.choice((0.0, 0.5 * np.pi)) + rng.normal(0.0, 0.25)
    u = np.cos(angle) * (columns - middle[0]) + np.sin(angle) * (rows - middle[1])
    v = -np.sin(angle) * (columns - middle[0]) + np.cos(angle) * (rows - middle[1])
    half = share * shape[1] * np.array([1.0, rng.uniform(0.65, 1.0)])
    return np.maximum(np.abs(u) - half[0], np.abs(v) - half[1]).astype(np.float32)


def _plane(surface: Surface) -> Grid:
    """The plane that fits the surface best."""
    x, y = grid_axes(surface)
    grid_x, grid_y = np.meshgrid(x[::8], y[::8])
    columns = np.column_stack((grid_x.ravel(), grid_y.ravel(), np.ones(grid_x.size)))
    a, b, c = np.linalg.lstsq(columns, surface.depth_mm[::8, ::8].ravel(), rcond=None)[0]
    return (a * x + b * y[:, None] + c).astype(np.float32)
