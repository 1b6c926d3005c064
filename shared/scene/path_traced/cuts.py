"""Cuts, ridges and raised blocks of suture pads: paths on a ground's grid, and what they do to its depth and colour."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from shared.scene.path_traced.ground import Grid, blended
from shared.scene.random_fields import smooth_step

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
