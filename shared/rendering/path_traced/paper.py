"""A photograph of tissue, printed on paper that does not lie quite flat: its shading, glints and rods are ink."""

import cv2
import numpy as np

from schemas.messages import RectifiedStereo
from shared.rendering.path_traced.flesh import tapering_line, vessel_cover, wandering
from shared.rendering.path_traced.ground import Ground, blended, empty_surface, tilted, undulating
from shared.rendering.surface import rough_field, smooth_field, smooth_step

INKS = {
    "red": ((0.55, 0.16, 0.13), (0.28, 0.04, 0.04)),
    "pink": ((0.62, 0.33, 0.26), (0.36, 0.12, 0.09)),
    "sand": ((0.55, 0.43, 0.30), (0.30, 0.20, 0.13)),
}
YELLOW, WHITE, VESSEL, PEN = (0.66, 0.47, 0.18), (0.80, 0.80, 0.78), (0.26, 0.05, 0.09), (0.05, 0.05, 0.12)


def paper_ground(camera: RectifiedStereo, distance_mm: float, rng: np.random.Generator) -> Ground:
    """A print around that distance; everything about it is drawn."""
    surface = undulating(tilted(empty_surface(camera, distance_mm), rng, 0.12), rng, {60.0: rng.uniform(0.2, 1.2)})
    shape, mm = surface.depth_mm.shape, 1.0 / surface.step_mm
    base, dark = INKS[str(rng.choice(list(INKS), p=(0.55, 0.25, 0.2)))]
    ink = np.broadcast_to(np.array(base, dtype=np.float32), (*shape, 3)).copy()
    ink = blended(ink, dark, 0.9 * smooth_step(rough_field(rng, shape, 18.0 * mm, 4), 0.0, 1.8))
    edge = rng.uniform(0.8, 1.7)
    ink = blended(ink, YELLOW, 0.8 * smooth_step(rough_field(rng, shape, 15.0 * mm, 4), edge, edge + 0.5))
    relief = rough_field(rng, shape, rng.uniform(4.0, 10.0) * mm, 4)
    slope = np.gradient(cv2.GaussianBlur(relief, (0, 0), 1.5), axis=int(rng.integers(2))) * 9.0
    ink *= np.clip(1.0 + rng.uniform(0.4, 1.0) * slope, 0.25, 1.8)[..., None]
    for width_mm, count in ((0.7, 4), (0.3, 9)):
        number = int(rng.poisson(count * rng.uniform(0.2, 1.5)))
        ink = blended(ink, VESSEL, rng.uniform(0.35, 0.7) * vessel_cover(rng, shape, width_mm * mm, number, 0.4))
    ink = _with_glints(rng, ink, mm)
    for _ in range(int(rng.integers(0, 3))):
        ink = _with_rod(rng, ink, mm)
    if rng.uniform() < 0.15:
        ink = _with_pen(rng, ink, mm)
    ink = cv2.GaussianBlur(ink.astype(np.float32), (0, 0), rng.uniform(0.4, 1.6))
    ink *= 1.0 + 0.03 * smooth_field(rng, shape, 0.5 * mm)[..., None]
    roughness = np.full(shape, rng.uniform(0.5, 0.9), dtype=np.float32)
    film = np.full(shape, max(rng.uniform(-0.15, 0.12), 0.0), dtype=np.float32)
    return Ground(surface, np.clip(ink, 0.01, 0.9).astype(np.float32), roughness, film)


def _with_glints(rng: np.random.Generator, ink: np.ndarray, mm: float) -> np.ndarray:
    """Printed highlights: ragged white blobs."""
    edge = rng.uniform(2.0, 3.0)
    field = rough_field(rng, ink.shape[:2], rng.uniform(3.0, 6.0) * mm, 3)
    return blended(ink, WHITE, 0.95 * smooth_step(field, edge, edge + 0.15))


def _with_rod(rng: np.random.Generator, ink: np.ndarray, mm: float) -> np.ndarray:
    """A printed instrument: a grey rod, bright along its middle and dark at its edges, that comes from a border."""
    rows, columns = ink.shape[:2]
    tip = rng.uniform(0.2, 0.8, 2) * (columns, rows)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    far = tip + 2.0 * columns * np.array([np.cos(angle), np.sin(angle)])
    radius = rng.uniform(1.5, 3.2) * mm
    brightness = rng.uniform(0.15, 0.5)
    for share, level in ((1.0, 0.25), (0.88, 0.65), (0.65, 0.85), (0.4, 1.0), (0.15, 1.25)):
        cover = np.zeros((rows, columns), dtype=np.float32)
        ends = [tuple(int(value) for value in np.rint(point * 16.0)) for point in (tip, far)]
        cv2.line(cover, ends[0], ends[1], 1.0, max(round(2.0 * radius * share), 1), cv2.LINE_AA, 4)
        grey = brightness * level
        ink = blended(ink, (grey, grey, 0.97 * grey), cover)
    return ink


def _with_pen(rng: np.random.Generator, ink: np.ndarray, mm: float) -> np.ndarray:
    """Marks of a pen: dark lines as thin as thread, straight or curved, which are none."""
    cover = np.zeros(ink.shape[:2], dtype=np.uint8)
    for _ in range(int(rng.integers(1, 4))):
        start = rng.uniform(0.1, 0.9, 2) * (ink.shape[1], ink.shape[0])
        path = wandering(rng, start, rng.uniform(0.0, 6.3), 4.0, int(rng.integers(30, 150)), rng.choice((0.0, 0.1)))
        width = rng.uniform(0.3, 0.8) * mm
        tapering_line(cover, path, width, width)
    return blended(ink, PEN, rng.uniform(0.5, 0.95) * cover.astype(np.float32) / 255.0)
