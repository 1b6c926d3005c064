"""Raw flesh: pale meat with fascia and fat as of a chicken, or red tissue with vessels, under a wet film."""

import cv2
import numpy as np

from schemas.messages import RectifiedStereo
from shared.scene.path_traced.ground import Grid, Ground, blended, empty_surface, raised, tilted, undulating
from shared.scene.path_traced.vessels import vessel_cover
from shared.scene.random_fields import rough_field, smooth_field, smooth_step

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
