"""What perception remembers from one frame to the next, so that it need not look everywhere in each.

The thread is looked for near where it was. What could make that wrong has the whole images looked at again: thread at
the border of what was looked at, less thread than there was, and every so many frames in any case. The segmenter is
chosen, and the pair judged, with each look at the whole.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from agents.perception.segmentation.choice import SEGMENTERS, suitable_segmenter
from agents.perception.segmentation.near import Near
from schemas.messages import Judgement

FRAMES_BETWEEN_LOOKS = 30
"""Of the camera: about a second, after which thread that came into view elsewhere is seen too."""
MARGIN_SHARE = 0.04
"""Of the width: how far from where it was thread is looked for. It may move so far between two frames."""
SMALL_WIDTH_PX = 240
"""Of the image in which the margin is laid around the thread."""
LEAST_KEPT_SHARE = 0.7
"""Of the thread's pixels when the whole images were last looked at; fewer mean that some of it has been lost."""
BESIDE_PX = 5, 13
"""Sides of the windows that make the ring beside the thread."""
BORDER_PX = 9
"""Thread so near to the border of what was looked at may go on beyond it."""

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class Remembered:
    """What the last frames gave.

    Fields:
        looked_sequence: of the frame whose whole images were last looked at.
        segmenter: chosen then.
        judgements: made then.
        pixels: how many were thread then, left and right.
        is_bright: whether the thread was brighter than its surroundings then.
        coverage: of the last frame, left and right.
    """

    looked_sequence: int
    segmenter: str
    judgements: tuple[Judgement, ...]
    pixels: tuple[int, int]
    is_bright: bool
    coverage: Pair

    @property
    def carried_on(self) -> tuple[Judgement, ...]:
        """The judgements, each saying when it was made."""
        when = f" (judged in frame {self.looked_sequence})"
        return tuple(replace(judgement, finding=judgement.finding + when) for judgement in self.judgements)


@dataclass(frozen=True)
class Looked:
    """What was segmented in a pair.

    Fields:
        coverage: by thread, left and right.
        near: the memory by which only a part of each image was looked at; None where the whole of both was.
    """

    coverage: Pair
    segmenter: str
    near: Remembered | None


def look_everywhere(images: Pair, segmenter: str | None) -> Looked:
    """Segment the whole of both images with a segmenter, or with the one that suits the left image."""
    name = segmenter or suitable_segmenter(images[0])
    segment = SEGMENTERS[name]
    return Looked((segment(images[0]), segment(images[1])), name, None)


def look_near(images: Pair, remembered: Remembered, sequence: int) -> Looked | None:
    """Segment what lies near the last thread; None where that does not do, and all must be looked at."""
    if not 0 < sequence - remembered.looked_sequence < FRAMES_BETWEEN_LOOKS:
        return None
    segment = SEGMENTERS[remembered.segmenter]
    found: list[np.ndarray] = []
    for image, before, pixels in zip(images, remembered.coverage, remembered.pixels, strict=True):
        near = Near(near_thread(before), remembered.is_bright)
        coverage = segment(image, near)
        if may_lack_thread(coverage, near.where, pixels):
            return None
        found.append(coverage)
    return Looked((found[0], found[1]), remembered.segmenter, remembered)


def remember(
    looked: Looked, left: UInt8[np.ndarray, "h w 3"], sequence: int, judgements: tuple[Judgement, ...]
) -> Remembered:
    """What the next frame may know of this one, in whose left image thread was observed."""
    if looked.near is not None:
        return replace(looked.near, coverage=looked.coverage)
    pixels = _pixels(looked.coverage[0]), _pixels(looked.coverage[1])
    is_bright = is_brighter(left, looked.coverage[0])
    return Remembered(sequence, looked.segmenter, judgements, pixels, is_bright, looked.coverage)


def is_brighter(image: UInt8[np.ndarray, "h w 3"], coverage: UInt8[np.ndarray, "h w"]) -> bool:
    """Whether what is covered is brighter than what lies beside it."""
    beside, around = (cv2.dilate(coverage, np.ones((side, side), np.uint8)) for side in BESIDE_PX)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return bool(cv2.mean(grey, coverage)[0] > cv2.mean(grey, cv2.subtract(around, beside))[0])


def near_thread(coverage: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Where a thread that covered this may be in the next frame."""
    height, width = coverage.shape
    share = min(1.0, SMALL_WIDTH_PX / width)
    size = max(1, round(width * share)), max(1, round(height * share))
    small = (cv2.resize(coverage, size, interpolation=cv2.INTER_AREA) > 0).astype(np.uint8)
    side = 2 * max(1, round(MARGIN_SHARE * size[0])) + 1
    wide = cv2.dilate(small, np.ones((side, side), np.uint8))
    return cv2.resize(wide, (width, height), interpolation=cv2.INTER_NEAREST) > 0


def may_lack_thread(coverage: UInt8[np.ndarray, "h w"], near: Bool[np.ndarray, "h w"], pixels_before: int) -> bool:
    """Whether thread that was found near a place may go on elsewhere, or part of it has been lost."""
    found = _pixels(coverage)
    if found < LEAST_KEPT_SHARE * pixels_before:
        return True
    # beyond the image's own border there is nothing to look at
    inside = cv2.erode(near.astype(np.uint8), np.ones((2 * BORDER_PX + 1,) * 2, np.uint8))
    return _pixels(cv2.bitwise_and(coverage, coverage, mask=inside)) < found


def _pixels(coverage: np.ndarray) -> int:
    return int(np.count_nonzero(coverage))
