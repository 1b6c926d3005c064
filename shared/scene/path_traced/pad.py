"""Suture pads of silicone with cuts, blocks, ridges, letters and inked lines; and a phantom of plain silicone skin."""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float32

from schemas.messages import RectifiedStereo
from shared.scene.path_traced.cuts import INSIDES, Cut, blocks, carve, drawn_lines, lips, ridges
from shared.scene.path_traced.ground import (
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
from shared.scene.path_traced.inks import ink, letters, pen_marks, specks
from shared.scene.path_traced.vessels import vessel_cover
from shared.scene.random_fields import rough_field, smooth_field, smooth_step
from shared.scene.surface import Surface

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
