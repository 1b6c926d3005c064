"""What the thread lies on: a height field with its colour, roughness and wet film, on one grid in millimetres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from schemas.messages import RectifiedStereo
from shared.rendering.surface import Surface, smooth_field

STEP_MM = 0.15
MARGIN = 1.3

Grid = Float32[np.ndarray, "h w"]


@dataclass(frozen=True)
class Ground:
    """A surface and, on its grid: linear albedo (red first), roughness, and the strength of its clear film.

    Fields:
        carrying: what thread lies on, where that is not the surface: cuts are bridged.
        is_mirrored: whether colour, roughness and film lie upside down on the surface, as they do on the first two
            backgrounds, whose scenes stay as they are.
    """

    surface: Surface
    albedo: Float32[np.ndarray, "h w 3"]
    roughness: Grid
    film: Grid
    carrying: Surface | None = None
    is_mirrored: bool = True

    @property
    def bed(self) -> Surface:
        """What thread lies on."""
        return self.surface if self.carrying is None else self.carrying


def empty_surface(camera: RectifiedStereo, distance_mm: float, step_mm: float = STEP_MM) -> Surface:
    """A plane at that distance, on a grid as far as both cameras can see it."""
    far = MARGIN * distance_mm
    x0 = -(camera.cx_px + 1.0) / camera.fx_px * far
    y0 = -(camera.cy_px + 1.0) / camera.fy_px * far
    x1 = (camera.image_width - camera.cx_px) / camera.fx_px * far + camera.baseline
    y1 = (camera.image_height - camera.cy_px) / camera.fy_px * far
    shape = (int((y1 - y0) / step_mm) + 2, int((x1 - x0) / step_mm) + 2)
    return Surface(np.full(shape, distance_mm, dtype=np.float32), x0, y0, step_mm)


def tilted(surface: Surface, rng: np.random.Generator, most: float) -> Surface:
    """The surface turned away from the camera by slopes up to `most`."""
    slope = np.clip(rng.normal(0.0, 0.5 * most, 2), -most, most).astype(np.float32)
    x, y = grid_axes(surface)
    return raised(surface, slope[0] * x + slope[1] * y[:, None])


def undulating(surface: Surface, rng: np.random.Generator, sizes: dict[float, float]) -> Surface:
    """The surface with relief: for each size in mm, its deviation in mm."""
    for size_mm, deviation_mm in sizes.items():
        relief = smooth_field(rng, surface.depth_mm.shape, size_mm / surface.step_mm)
        surface = raised(surface, deviation_mm * relief)
    return surface


def raised(surface: Surface, depth_mm: Grid) -> Surface:
    """The surface with depth added to it, away from the camera where positive."""
    depth = (surface.depth_mm + depth_mm).astype(np.float32)
    return Surface(depth, surface.x0_mm, surface.y0_mm, surface.step_mm)


def grid_axes(surface: Surface) -> tuple[Float32[np.ndarray, "w"], Float32[np.ndarray, "h"]]:
    """The x of its columns and the y of its rows."""
    rows, columns = surface.depth_mm.shape
    x = surface.x0_mm + surface.step_mm * np.arange(columns, dtype=np.float32)
    y = surface.y0_mm + surface.step_mm * np.arange(rows, dtype=np.float32)
    return x, y


def blended(under: np.ndarray, over: tuple[float, float, float], cover: Grid) -> np.ndarray:
    """Colours with another laid over them."""
    return under + cover[..., None] * (np.array(over, dtype=np.float32) - under)
