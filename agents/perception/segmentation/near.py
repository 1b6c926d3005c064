"""What is known of a thread before it is looked for: where it may be, and which of several is meant."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8


@dataclass(frozen=True)
class Near:
    """Where a thread may be, and how it looks.

    Fields:
        where: pixels that may be thread, in the image that is to be segmented.
        is_bright: whether it is brighter than its surroundings; else it is darker.
    """

    where: Bool[np.ndarray, "h w"]
    is_bright: bool


@dataclass(frozen=True)
class Meant:
    """Which of several threads is meant: the connected piece that has most weight.

    Fields:
        weight: of each pixel of the image that is to be segmented, from 0.
        alone: whether only that piece is kept; else also what looks like it.
        other_eye: coverage by it in the left image, where only there it was said what is meant, and this is the right.
    """

    weight: Float32[np.ndarray, "h w"]
    alone: bool
    other_eye: UInt8[np.ndarray, "h w"] | None = None


def piece_meant(mask: Bool[np.ndarray, "h w"], weight: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The connected piece of a mask with most weight; nothing where none has any."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    total = np.bincount(np.asarray(labels)[mask], weights=weight[mask], minlength=count)
    return np.asarray(labels) == int(np.argmax(total)) if total.any() else np.zeros(mask.shape, bool)
