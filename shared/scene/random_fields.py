"""Smooth random fields on a grid: white noise under a Gaussian, which has no preferred direction, at given sizes."""

import cv2
import numpy as np
from jaxtyping import Float32

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
