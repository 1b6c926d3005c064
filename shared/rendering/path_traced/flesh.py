"""Raw flesh: pale meat with fascia and fat as of a chicken, or red tissue with vessels, under a wet film.

On it are lines that look like thread and are none (vessels that wander and fork, hairs of fascia, marks of a pen), and
blood and dark fluid: pools with a film, drops, and smears.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float32

from schemas.messages import RectifiedStereo
from shared.rendering.path_traced.ground import Grid, Ground, blended, empty_surface, raised, tilted, undulating
from shared.rendering.surface import rough_field, smooth_field, smooth_step

SUBSTEPS = 16


def vessel_cover(
    rng: np.random.Generator, shape: tuple[int, int], width: float, count: int, wander: float = 0.28
) -> Float32[np.ndarray, "h w"]:
    """Cover, 0 to 1, by so many vessels that thin out and fork; `width` in grid steps where they are widest."""
    image = np.zeros(shape, dtype=np.uint8)
    for _ in range(count):
        start = rng.uniform(0.0, 1.0, 2) * (shape[1], shape[0])
        heading = rng.uniform(0.0, 2.0 * np.pi)
        wide = width * rng.uniform(0.5, 1.3)
        path = wandering(rng, start, heading, 4.0, 180, wander)
        tapering_line(image, path, wide, 0.35 * wide)
        for fork in rng.integers(10, len(path), rng.integers(0, 4)):
            branch = wandering(rng, path[fork], heading + rng.choice((-0.8, 0.8)), 4.0, 80, wander)
            tapering_line(image, branch, 0.6 * wide, 0.15 * wide)
    return cv2.GaussianBlur(image.astype(np.float32) / 255.0, (0, 0), 0.15 * width + 0.5)


def wandering(
    rng: np.random.Generator, start: np.ndarray, heading: float, step: float, count: int, wander: float
) -> Float32[np.ndarray, "n 2"]:
    """A path whose heading changes smoothly at random."""
    turn = cv2.GaussianBlur(rng.normal(0.0, 1.0, (1, count)), (0, 0), 5.0).ravel() * wander
    headings = heading + np.cumsum(turn)
    steps = step * np.column_stack((np.cos(headings), np.sin(headings)))
    return (start + np.cumsum(steps, axis=0)).astype(np.float32)


def tapering_line(image: np.ndarray, path: np.ndarray, wide: float, narrow: float) -> None:
    """Draw a path whose width falls from its start to its end; widths below one step draw as faint lines."""
    pieces = np.array_split(np.arange(len(path)), 6)
    for part, width in zip(pieces, np.linspace(wide, narrow, len(pieces)), strict=True):
        piece = np.rint(path[max(part[0] - 1, 0) : part[-1] + 1] * SUBSTEPS).astype(np.int32)
        strength = int(255 * min(max(width, 0.25), 1.0))
        cv2.polylines(image, [piece.reshape(-1, 1, 2)], False, strength, max(round(width), 1), cv2.LINE_AA, 4)


MEATS = {
    "pale": ((0.60, 0.42, 0.33), (0.45, 0.24, 0.19), (0.70, 0.56, 0.46)),
    "red": ((0.52, 0.16, 0.11), (0.30, 0.05, 0.04), (0.66, 0.32, 0.24)),
    "brown": ((0.33, 0.12, 0.08), (0.18, 0.05, 0.04), (0.42, 0.20, 0.14)),
}
"""Linear albedo, red first: what most of it is, its dark patches, its pale ones."""

FAT, ARTERY, VEIN, CAPILLARY = (0.58, 0.42, 0.14), (0.33, 0.03, 0.03), (0.16, 0.05, 0.09), (0.36, 0.06, 0.05)


def flesh_ground(camera: RectifiedStereo, distance_mm: float, rng: np.random.Generator) -> Ground:
    """A piece of flesh around that distance; everything about it is drawn."""
    meat = str(rng.choice(list(MEATS), p=(0.45, 0.45, 0.10)))
    surface = empty_surface(camera, distance_mm)
    shape, mm = surface.depth_mm.shape, 1.0 / surface.step_mm
    strength = rng.uniform(0.4, 1.3)
    relief = {40.0: 1.6 * strength, 14.0: 0.55 * strength, 5.0: 0.12 * strength}
    surface = undulating(tilted(surface, rng, 0.12), rng, relief)
    fat = _fat(rng, shape, mm)
    fibres = _fibres(rng, shape, mm)
    albedo = _meat(rng, shape, mm, meat)
    albedo *= 1.0 + rng.uniform(0.05, 0.16) * fibres[..., None]
    albedo = _with_vessels(rng, albedo, mm, fat, rng.uniform(0.2, 1.0) if meat == "pale" else rng.uniform(0.5, 2.0))
    lobules = 1.0 + 0.12 * smooth_field(rng, shape, 1.3 * mm)
    albedo = blended(albedo, FAT, fat) * np.where(fat > 0.5, lobules, 1.0)[..., None]
    albedo *= 1.0 + 0.04 * smooth_field(rng, shape, 0.35 * mm)[..., None]
    wet = _wetness(rng, shape, mm)
    bumps = 0.26 * smooth_field(rng, shape, 4.5 * mm) + 0.08 * smooth_field(rng, shape, 1.6 * mm) + 0.03 * fibres
    bumps += 0.02 * smooth_field(rng, shape, 0.7 * mm)
    surface = raised(surface, rng.uniform(0.5, 1.6) * bumps * (0.4 + 0.8 * wet) - 0.15 * fat)
    roughness = 0.55 - 0.38 * wet + 0.05 * smooth_field(rng, shape, 6.0 * mm)
    return Ground(
        surface,
        np.clip(albedo, 0.005, 0.95).astype(np.float32),
        np.clip(roughness, 0.1, 0.9).astype(np.float32),
        np.clip(rng.uniform(0.3, 1.0) * wet, 0.0, 1.0).astype(np.float32),
    )


def _meat(rng: np.random.Generator, shape: tuple[int, int], mm: float, meat: str) -> np.ndarray:
    base, dark, light = MEATS[meat]
    tint = rng.normal(1.0, 0.06, 3)
    albedo = np.broadcast_to(np.array(base, dtype=np.float32) * tint.astype(np.float32), (*shape, 3)).copy()
    albedo = blended(albedo, light, 0.8 * smooth_step(rough_field(rng, shape, 24.0 * mm, 4), -0.4, 1.6))
    albedo = blended(albedo, dark, 0.8 * smooth_step(rough_field(rng, shape, 15.0 * mm, 4), 0.4, 2.0))
    return albedo * (1.0 + 0.07 * rough_field(rng, shape, 3.0 * mm, 4))[..., None]


def _fat(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    edge = rng.uniform(0.7, 1.6)
    return 0.85 * smooth_step(rough_field(rng, shape, rng.uniform(10.0, 24.0) * mm, 5), edge, edge + 0.25)


def _fibres(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    """Strands along a direction that changes slowly over the field: a stretched field, bent by another."""
    long = smooth_field(rng, shape, 0.8 * mm, stretch=(1.0, 14.0)) + 0.7 * smooth_field(
        rng, shape, 2.0 * mm, (1.0, 9.0)
    )
    bend = 6.0 * mm * smooth_field(rng, shape, 30.0 * mm)
    angle = rng.uniform(0.0, np.pi)
    rows, columns = np.indices(shape, dtype=np.float32)
    middle = 0.5 * np.array(shape)
    across, down = columns - middle[1], rows - middle[0]
    u = np.cos(angle) * across + np.sin(angle) * down + middle[1]
    v = -np.sin(angle) * across + np.cos(angle) * down + middle[0] + bend
    field = cv2.remap(
        long.astype(np.float32),
        u.astype(np.float32),
        v.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT,
    )
    return field / max(float(field.std()), 1e-6)


def _with_vessels(rng: np.random.Generator, albedo: np.ndarray, mm: float, fat: Grid, amount: float) -> np.ndarray:
    kinds = ((ARTERY, 0.35, 4, 0.55), (VEIN, 0.8, 3, 0.5), (CAPILLARY, 0.16, 12, 0.6))
    for colour, width_mm, count, strength in kinds:
        number = int(rng.poisson(count * amount))
        cover = vessel_cover(rng, fat.shape, width_mm * mm, number, rng.uniform(0.15, 0.45))
        albedo = blended(albedo, colour, strength * rng.uniform(0.5, 1.2) * cover * (1.0 - 0.7 * fat))
    return albedo


def _wetness(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    low = rng.uniform(-1.6, 0.4)
    return smooth_step(rough_field(rng, shape, rng.uniform(6.0, 14.0) * mm, 3), low, low + 1.4)


FLUIDS = {"blood": (0.20, 0.012, 0.012), "old blood": (0.07, 0.015, 0.012), "bile": (0.16, 0.17, 0.03)}


def stained(ground: Ground, rng: np.random.Generator) -> Ground:
    """The ground with fluid on it, which is darker, smoother and glossier."""
    fluid = FLUIDS[str(rng.choice(list(FLUIDS), p=(0.6, 0.3, 0.1)))]
    shape, mm = ground.film.shape, 1.0 / ground.surface.step_mm
    cover = np.maximum.reduce([_pools(rng, shape, mm), _drops(rng, shape, mm), _smears(rng, shape, mm)])
    albedo = blended(ground.albedo, fluid, (rng.uniform(0.6, 0.95) * cover).astype(np.float32))
    roughness = ground.roughness + cover * (0.12 - ground.roughness)
    film = np.maximum(ground.film, 0.8 * cover)
    return replace(
        ground,
        albedo=albedo.astype(np.float32),
        roughness=roughness.astype(np.float32),
        film=film.astype(np.float32),
    )


def _pools(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    edge = rng.uniform(1.2, 2.4)
    return smooth_step(rough_field(rng, shape, rng.uniform(8.0, 20.0) * mm, 4), edge, edge + 0.15)


def _drops(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    image = np.zeros(shape, dtype=np.uint8)
    for _ in range(int(rng.poisson(8))):
        x, y = (int(value) for value in rng.uniform(0.0, 1.0, 2) * (shape[1], shape[0]))
        axes = tuple(int(value) for value in np.maximum(rng.uniform(0.3, 1.5, 2) * mm, 1.0))
        cv2.ellipse(image, (x, y), axes, float(rng.uniform(0.0, 180.0)), 0.0, 360.0, 255, -1, cv2.LINE_AA)
    return image.astype(np.float32) / 255.0


def _smears(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    """Thin streaks that run dry: they look like dark red thread."""
    image = np.zeros(shape, dtype=np.uint8)
    for _ in range(int(rng.poisson(2))):
        start = rng.uniform(0.1, 0.9, 2) * (shape[1], shape[0])
        path = wandering(rng, start, rng.uniform(0.0, 6.3), 4.0, int(rng.integers(20, 90)), 0.15)
        tapering_line(image, path, rng.uniform(0.4, 2.0) * mm, 0.15 * mm)
    return cv2.GaussianBlur(image.astype(np.float32) / 255.0, (0, 0), 0.8)
