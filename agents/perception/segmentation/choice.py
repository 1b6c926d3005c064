"""The segmenters by name, and which of them suits an image that nobody has said anything about."""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from jaxtyping import UInt8

from agents.perception.segmentation.near import Meant, Near
from agents.perception.segmentation.network import segment_and_score, segment_network
from agents.perception.segmentation.promptable import PromptableSegmenter
from agents.perception.segmentation.promptable_model import PromptableFiles, PromptableModel
from agents.perception.segmentation.ridge import segment_ridge
from agents.perception.segmentation.threshold import LEAST_CONTRAST, local_contrast, segment_threshold
from agents.perception.segmenter_names import NETWORK, PROMPTABLE, RIDGE, THRESHOLD


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
    RIDGE: segment_ridge,
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


PLAIN_SHARE = 0.75
"""An image is plain where at least this share of its pixels hardly differs from its local background."""


def suitable_segmenter(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """`threshold` for thread on a plain ground, such as synthetic scenes and cut-out threads; `network` for tissue."""
    plain = float((local_contrast(image) < LEAST_CONTRAST).mean())
    return THRESHOLD if plain >= PLAIN_SHARE else NETWORK
