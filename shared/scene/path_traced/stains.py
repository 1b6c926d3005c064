"""Blood and dark fluid on the ground: pools with a film, drops, and smears."""

from dataclasses import replace

import cv2
import numpy as np

from shared.scene.path_traced.ground import Grid, Ground, blended
from shared.scene.path_traced.vessels import tapering_line, wandering
from shared.scene.random_fields import rough_field, smooth_step

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
