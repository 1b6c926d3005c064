"""The segmenters by name, and which of them suits an image that nobody has said anything about."""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from jaxtyping import UInt8

from agents.perception.segmentation.boxes import Meant, Near
from agents.perception.segmentation.network import segment_and_score, segment_network
from agents.perception.segmentation.promptable import PromptableSegmenter
from agents.perception.segmentation.promptable_model import PromptableFiles, PromptableModel
from agents.perception.segmentation.threshold import segment_threshold
from agents.perception.segmenter_names import NETWORK, PROMPTABLE, THRESHOLD


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


SEGMENTERS: dict[str, Segmenter] = {
    THRESHOLD: segment_threshold,
    NETWORK: segment_network,
}


Scored = tuple[UInt8[np.ndarray, "h w"], UInt8[np.ndarray, "h w"]]
SCORED: dict[Segmenter, Callable[[UInt8[np.ndarray, "h w 3"]], Scored]] = {segment_network: segment_and_score}
"""Of the segmenters that have a score of each pixel: what gives the coverage and the score, both 0 to 255."""


def segmenters_with(promptable: PromptableFiles | None) -> Mapping[str, Segmenter]:
    """All segmenters; the promptable one only with the files of its network.

    Raises:
        PromptableFileError: where those cannot be used.
    """
    return (
        SEGMENTERS
        if promptable is None
        else SEGMENTERS | {PROMPTABLE: PromptableSegmenter(PromptableModel(promptable))}
    )


PLAIN_SHARE = 0.95
"""An image is plain where at least this share of it is of one colour: what is not is no more than thread covers."""
PLAIN_LEVELS = 16
"""How far a pixel may be from that colour: noise and compression move it, and the light on a real ground by more."""
EACH_PX = 4
"""Of rows and columns, one of so many tells as much as all."""


def suitable_segmenter(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """`threshold` for thread on a ground of one colour, as of synthetic scenes and cut-out threads; else `network`."""
    some = image[::EACH_PX, ::EACH_PX].reshape(-1, 3)
    away = np.abs(some - np.median(some, axis=0)).max(axis=1)
    return THRESHOLD if (away < PLAIN_LEVELS).mean() >= PLAIN_SHARE else NETWORK
