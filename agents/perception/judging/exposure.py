"""Whether an image is too dark or too bright to show anything, from a sample of its pixels."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

EVERY_PX = 8
"""Pixels are taken from every so many rows and columns: some thousands tell as much as all, in a tenth of a ms."""
BURNT_LEVEL, NEARLY_LEVEL = 250, 215
"""From these grey levels on a pixel tells nothing any more, and nearly so."""


@dataclass(frozen=True)
class Exposure:
    """How bright an image is.

    Fields:
        median, bright: grey levels that half of the pixels, and 2 % of them, are above.
        burnt: share of the pixels that are as bright as can be.
        spread: grey levels from the darkest to the brightest pixel.
        nearly: share of the others that come close to it.
        one_value: share of the pixels that have exactly the most frequent colour.
    """

    median: float
    bright: float
    spread: float
    burnt: float
    nearly: float
    one_value: float


def exposure(image: UInt8[np.ndarray, "h w *c"]) -> Exposure:
    """How bright an image is, by its grey levels."""
    some = np.ascontiguousarray(image[EVERY_PX // 2 :: EVERY_PX, EVERY_PX // 2 :: EVERY_PX])
    if some.size == 0:
        some = np.ascontiguousarray(image)
    level = cv2.cvtColor(some, cv2.COLOR_BGR2GRAY) if some.ndim == 3 else some
    count = np.bincount(level.ravel(), minlength=256)
    of_all = count.cumsum() / level.size
    burnt = count[BURNT_LEVEL:].sum() / level.size
    nearly = count[NEARLY_LEVEL:BURNT_LEVEL].sum() / max(level.size - count[BURNT_LEVEL:].sum(), 1)
    return Exposure(
        median=float(np.searchsorted(of_all, 0.5)),
        bright=float(np.searchsorted(of_all, 0.98)),
        spread=float(np.ptp(level)),
        burnt=float(burnt),
        nearly=float(nearly),
        one_value=float(count.max() / level.size),
    )
