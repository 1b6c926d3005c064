"""The segmenters by name, and which of them suits an image that nobody has said anything about."""

from typing import Protocol

import numpy as np
from jaxtyping import UInt8

from agents.perception.segmentation.near import Meant, Near
from agents.perception.segmentation.ridge import segment_ridge
from agents.perception.segmentation.threshold import LEAST_CONTRAST, local_contrast, segment_threshold
from agents.perception.segmenter_names import RIDGE, THRESHOLD


class Segmenter(Protocol):
    """Finds thread in an image."""

    def __call__(
        self, image: UInt8[np.ndarray, "h w 3"], near: Near | None = None, meant: Meant | None = None
    ) -> UInt8[np.ndarray, "h w"]:
        """A rectified colour image to the coverage of each pixel by thread, 0 to 255.

        Args:
            near: where thread is looked for; anywhere, if it is None.
            meant: which thread is meant, of several; the most conspicuous, or all of them, if it is None.
        """
        ...


SEGMENTERS: dict[str, Segmenter] = {THRESHOLD: segment_threshold, RIDGE: segment_ridge}

PLAIN_SHARE = 0.75
"""An image is plain where at least this share of its pixels hardly differs from its local background."""


def suitable_segmenter(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """`threshold` for a thread on a plain ground, such as synthetic scenes and cut-out threads; `ridge` for tissue."""
    plain = float((local_contrast(image) < LEAST_CONTRAST).mean())
    return "threshold" if plain >= PLAIN_SHARE else "ridge"
