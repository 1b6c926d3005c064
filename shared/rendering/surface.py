"""The tissue's surface as a height field z = H(x, y) in the left camera's frame, in millimetres.

The ray of pixel (u, v) of a camera at (e, 0, 0) meets it where z = H(e + p z, q z), with p = (u − cx)/fx and
q = (v − cy)/fy. Iterating that equation converges, since the slope of H times the tangent of the ray's angle is well
below one for a surface that faces the camera.

Its smooth random fields are white noise under a Gaussian, which has no preferred direction, at given sizes.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from schemas.messages import RectifiedStereo

CELLS_PER_SIZE = 6.0
MARGIN_CELLS = 10


def smooth_field(
    rng: np.random.Generator, shape: tuple[int, int], size: float, stretch: tuple[float, float] = (1.0, 1.0)
) -> Float32[np.ndarray, "h w"]:
    """A field of zero mean and unit deviation whose features are about `size` grid steps large.

    `stretch` multiplies the size across rows and across columns, for fibres.
    """
    # whole cells, since resizing by whole numbers is exact where OpenCV's warps round to 1/32 of a cell
    cell = [max(round(size * factor / CELLS_PER_SIZE), 1) for factor in stretch]
    coarse = [int(np.ceil(length / step)) + 2 * MARGIN_CELLS for length, step in zip(shape, cell, strict=True)]
    sigma = [0.5 * size * factor / step for factor, step in zip(stretch, cell, strict=True)]
    noise = rng.standard_normal(coarse, dtype=np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), sigmaX=sigma[1], sigmaY=sigma[0])
    fine = (coarse[1] * cell[1], coarse[0] * cell[0])
    field = cv2.resize(noise, fine, interpolation=cv2.INTER_LINEAR)
    # two running means make it a spline of the coarse grid, whose slopes do not show the cells; OpenCV's cubic does
    for _ in range(2):
        field = cv2.blur(field, (cell[1], cell[0]))
    top, left = MARGIN_CELLS * cell[0], MARGIN_CELLS * cell[1]
    field = field[top : top + shape[0], left : left + shape[1]]
    return ((field - field.mean()) / max(float(field.std()), 1e-6)).astype(np.float32)


def rough_field(
    rng: np.random.Generator, shape: tuple[int, int], size: float, octaves: int
) -> Float32[np.ndarray, "h w"]:
    """A sum of smooth fields, each half as large and half as strong as the one before; unit deviation."""
    field = np.zeros(shape, dtype=np.float32)
    for octave in range(octaves):
        field += 0.5**octave * smooth_field(rng, shape, size * 0.5**octave)
    return field / max(float(field.std()), 1e-6)


def smooth_step(values: Float32[np.ndarray, "h w"], low: float, high: float) -> Float32[np.ndarray, "h w"]:
    """0 below `low`, 1 above `high`, and smooth between."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return (t * t * (3.0 - 2.0 * t)).astype(np.float32)


STEP_MM = 0.1
ITERATIONS = 12


@dataclass(frozen=True)
class Surface:
    """Depths of a grid of points: row i, column j lies at (x0 + j step, y0 + i step); beyond it, as at its border."""

    depth_mm: Float32[np.ndarray, "h w"]
    x0_mm: float
    y0_mm: float
    step_mm: float


def flat_surface(distance_mm: float) -> Surface:
    """A plane that faces the camera."""
    return Surface(np.full((2, 2), distance_mm, dtype=np.float32), 0.0, 0.0, 1.0)


def tissue_surface(camera: RectifiedStereo, distance_mm: float, seed: int) -> Surface:
    """A gently tilted, undulating surface around that distance, as far as both cameras can see it."""
    rng = np.random.default_rng([seed, 1])
    far = 1.25 * distance_mm
    x0 = -(camera.cx_px + 1.0) / camera.fx_px * far
    y0 = -(camera.cy_px + 1.0) / camera.fy_px * far
    x1 = (camera.image_width - camera.cx_px) / camera.fx_px * far + camera.baseline
    y1 = (camera.image_height - camera.cy_px) / camera.fy_px * far
    shape = (int((y1 - y0) / STEP_MM) + 2, int((x1 - x0) / STEP_MM) + 2)
    relief = 1.6 * smooth_field(rng, shape, 40.0 / STEP_MM)
    relief += 0.55 * smooth_field(rng, shape, 14.0 / STEP_MM)
    relief += 0.12 * smooth_field(rng, shape, 5.0 / STEP_MM)
    tilt = np.clip(rng.normal(0.0, 0.06, 2), -0.12, 0.12).astype(np.float32)
    x = x0 + STEP_MM * np.arange(shape[1], dtype=np.float32)
    y = y0 + STEP_MM * np.arange(shape[0], dtype=np.float32)
    return Surface(distance_mm + relief + tilt[0] * x + tilt[1] * y[:, None], x0, y0, STEP_MM)


def sample_grid(
    grid: np.ndarray, surface: Surface, x_mm: np.ndarray, y_mm: np.ndarray
) -> Float32[np.ndarray, "h w ..."]:
    """Values of any grid that is laid out as the surface's, at (x, y)."""
    column = ((x_mm - surface.x0_mm) / surface.step_mm).astype(np.float32)
    row = ((y_mm - surface.y0_mm) / surface.step_mm).astype(np.float32)
    return cv2.remap(grid, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def ray_tangents(camera: RectifiedStereo) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Slopes p = x/z and q = y/z of the rays of all pixels."""
    p = (np.arange(camera.image_width) - camera.cx_px) / camera.fx_px
    q = (np.arange(camera.image_height) - camera.cy_px) / camera.fy_px
    p, q = np.meshgrid(p.astype(np.float32), q.astype(np.float32))
    return p, q


def meet_rays(
    surface: Surface, p: Float32[np.ndarray, "h w"], q: Float32[np.ndarray, "h w"], eye_x_mm: float
) -> Float32[np.ndarray, "h w"]:
    """Depth at which rays (e + p z, q z, z) meet the surface."""
    z = np.full(p.shape, float(surface.depth_mm.mean()), dtype=np.float32)
    for _ in range(ITERATIONS):
        z = sample_grid(surface.depth_mm, surface, eye_x_mm + p * z, q * z)
    return z


def depth_at_points(surface: Surface, xy_mm: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n"]:
    """Depth of the surface beneath points (x, y)."""
    # remap takes images of fewer than 32768 columns, so points travel as rows
    x, y = xy_mm[:, :1], xy_mm[:, 1:]
    return sample_grid(surface.depth_mm, surface, x, y)[:, 0].astype(np.float64)
