"""Lines that look like thread and are none: vessels that wander and fork, hairs of fascia, marks of a pen."""

import cv2
import numpy as np
from jaxtyping import Float32

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
