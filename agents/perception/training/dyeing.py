"""The thread of a rendered view in another colour: its shading, glints and edges stay, its dye is drawn anew.

So training sees threads of every colour without new renders, red ones above all: the colour alone would take them for
vessels.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from agents.perception.training.clutter import Coverage, Image

RED_SHARE = 0.5
"""Of the colours drawn; the others are of any hue."""
CORE = 230
"""Coverage, 0 to 255, from which on a pixel shows thread alone."""
GROUND_SIGMA_PX = 6.0
GLINT = 1.6
"""Times a thread's usual brightness: what is brighter is light that its surface mirrors, which has no dye."""
LEAST_CONTRAST = 28.0
"""In grey levels of the channel that differs most: a thread less unlike its ground than this cannot be told."""
TRIES = 4
UNEVEN_SHARE, UNEVEN_CELLS = 0.5, (3, 12)
"""How often its brightness changes along it besides, as that of a twisted or glossy thread, and in how many cells a
side."""


def with_other_dye(image: Image, coverage: Coverage, rng: np.random.Generator) -> Image:
    """The view with each connected piece of thread in a colour of its own; as it was where none would be seen."""
    core = coverage >= CORE
    count, piece = cv2.connectedComponents((coverage > 0).view(np.uint8), connectivity=8)
    if count < 2 or not core.any():
        return image
    before = image.astype(np.float32)
    ground = _spread(before, coverage == 0)
    # a mixed pixel holds as much thread as it is covered, of the brightness of the thread beside it
    grey = np.where(core, before.mean(axis=2), _spread(before.mean(axis=2)[..., None], core)[..., 0])
    thread = np.where(core[..., None], before, _spread(before, core))
    shade = np.ones(coverage.shape, np.float32)
    if rng.uniform() < UNEVEN_SHARE:
        cells = int(rng.integers(*UNEVEN_CELLS))
        uneven = np.exp(rng.normal(0, rng.uniform(0.1, 0.5), (cells, cells))).astype(np.float32)
        shade = np.asarray(cv2.resize(uneven, coverage.shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)
    alpha = (coverage.astype(np.float32) / 255)[..., None]
    dyed = before.copy()
    for number in range(1, count):
        own = piece == number
        if (own & core).sum() < 4:
            continue
        new = _dyed(grey, shade, ground, own, own & core, rng)
        if new is not None:
            dyed[own] += (alpha * (new - thread))[own]
    return np.clip(dyed + 0.5, 0, 255).astype(np.uint8)


def _dyed(
    grey: Float32[np.ndarray, "h w"],
    shade: Float32[np.ndarray, "h w"],
    ground: Float32[np.ndarray, "h w 3"],
    own: Bool[np.ndarray, "h w"],
    core: Bool[np.ndarray, "h w"],
    rng: np.random.Generator,
) -> Float32[np.ndarray, "h w 3"] | None:
    """One piece in a colour that its ground does not have; None where none of some colours was unlike it."""
    usual = max(float(np.median(grey[core])), 4.0)
    contrast = rng.uniform(0.5, 1.2)
    body = np.clip(grey / usual, 0.05, GLINT) ** contrast * np.clip(shade, 0.3, 1.8)
    glints = np.clip(grey - GLINT * usual, 0, None) * rng.uniform(0.3, 1.0)
    light = float(np.clip(ground[own].mean() / 130, 0.5, 1.4))
    for _ in range(TRIES):
        new = np.clip(body[..., None] * (light * _colour(rng)), 0, 250) + glints[..., None]
        if np.abs(new - ground)[core].max(axis=1).mean() >= LEAST_CONTRAST:
            return np.clip(new, 0, 255).astype(np.float32)
    return None


def _colour(rng: np.random.Generator) -> Float32[np.ndarray, "3"]:
    """Blue first, 0 to 255."""
    if rng.uniform() < RED_SHARE:
        hue, saturation, value = rng.normal(0, 7) % 180, rng.uniform(0.4, 0.95), rng.uniform(0.3, 0.9)
    else:
        hue, saturation, value = rng.uniform(0, 180), rng.uniform(0.1, 1.0), rng.uniform(0.15, 0.95)
    hsv = np.array([[[2 * hue, saturation, value]]], np.float32)
    return 255 * np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR), np.float32)[0, 0]


def _spread(values: Float32[np.ndarray, "h w c"], known: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w c"]:
    """What is known about, blurred into what is not."""
    weight = known.astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), GROUND_SIGMA_PX)
    parts = [cv2.GaussianBlur(values[..., c] * weight, (0, 0), GROUND_SIGMA_PX) for c in range(values.shape[2])]
    return np.dstack(parts) / np.maximum(total, 1e-3)[..., None]
