"""Thread by a network that is told by points what is meant, crop by crop along the thread at full resolution.

Such a network's masks have 256 pixels a side whatever it is shown: in a whole endoscope image, one of them would be as
wide as a thread, or wider. So crops of about as many pixels are looked at, one after the other: prompts lie where
thread is known to be, the mask tells where it goes on, and the next crop is laid where most of that has not been looked
at. The logits of the crops are fused by their mean, in which a crop counts little near its own border; thread is above
0.
"""

from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from agents.perception.segmentation.boxes import Meant, Near, piece_meant
from agents.perception.segmentation.promptable_model import Embedded
from agents.perception.segmentation.promptable_prompts import middle_of, pointed_at, spread_points

CROP_SHARE = 0.3
"""Of the width: side of a crop, so that a thread is as many pixels of the mask wide in every image."""
LEAST_CROP_PX = 256
"""A pixel of the mask for each of the crop; smaller crops would show less around the thread and no more of it."""
MARGIN_SHARE = 0.125
"""Of a crop's side: what lies so near to its border is looked at again in the next crop."""
MOST_CROPS = 24
"""In one image; a thread across it twice takes about twelve."""
LARGEST_SHARE = 0.25
"""Of a crop; a mask that covers more is tissue or a tool, and no thread."""
LEAST_HIT_SHARE = 0.5
"""Of the prompts that a mask must hold."""
REACH_PX = 2
"""A prompt may lie so far beside the mask that it means."""
LARGEST_LOGIT = 10.0
"""One crop's certainty must not outvote all others'."""

Logits = Float32[np.ndarray, "h w"]


class Promptable(Protocol):
    """A network that is told by points what is meant."""

    def embed(self, crop: UInt8[np.ndarray, "h w 3"]) -> Embedded:
        """What the network makes of a crop before it is told anything."""
        ...

    def masks(
        self, embedded: Embedded, point_px: Float64[np.ndarray, "n 2"], is_thread: Bool[np.ndarray, "n"]
    ) -> tuple[Float32[np.ndarray, "m h w"], Float32[np.ndarray, "m"]]:
        """Logits of some masks of the crop, and how good each is by the network's own estimate."""
        ...


class PromptableSegmenter:
    """A segmenter that points a network to where thread may be."""

    def __init__(self, network: Promptable) -> None:
        self._network = network

    def __call__(
        self, image: UInt8[np.ndarray, "h w 3"], near: Near | None = None, meant: Meant | None = None
    ) -> UInt8[np.ndarray, "h w"]:
        """Coverage of each pixel by thread, 0 or 128 to 255; nothing where there is nothing to point at.

        Args:
            near: where thread was; what the network finds there are prompts.
            meant: which thread is; without one and without `near`, the ridges of the whole image are prompts.
        """
        for known in pointed_at(image, near, meant):
            logits = along_thread(image, known, self._network)
            thread = logits > 0
            if meant is not None and meant.alone:
                thread = piece_meant(thread, meant.weight)
            if thread.any():
                level = 255.0 / (1.0 + np.exp(-logits))
                return np.where(thread, np.maximum(level, 128.0), 0.0).astype(np.uint8)
        return np.zeros(image.shape[:2], np.uint8)


def crop_side(shape: tuple[int, ...]) -> int:
    """How many pixels the side of a crop has, in an image of that shape."""
    return min(max(LEAST_CROP_PX, round(CROP_SHARE * shape[1])), max(shape[:2]))


def along_thread(image: UInt8[np.ndarray, "h w 3"], known: Bool[np.ndarray, "h w"], network: Promptable) -> Logits:
    """Fused logits of the crops along a thread; the least there is where none was laid.

    Args:
        known: pixels in the middle of what is known of the thread.
    """
    total, weight = np.zeros(known.shape, np.float32), np.zeros(known.shape, np.float32)
    known, looked = known.copy(), np.zeros(known.shape, bool)
    side = crop_side(known.shape)
    for _ in range(MOST_CROPS):
        centre = next_centre(known & ~looked, side)
        if centre is None:
            break
        box, inner = boxes(centre, side, known.shape)
        looked[inner] = True
        corner = np.array([box[1].start, box[0].start], np.float64)
        points = spread_points(np.argwhere(known[box]), centre[::-1] - corner)
        logits = thread_in(image[box], points, network)
        certainty = _certainty(box, known.shape, side)
        total[box] += certainty * np.clip(logits, -LARGEST_LOGIT, LARGEST_LOGIT)
        weight[box] += certainty
        known[box] |= middle_of(logits > 0)
    return np.where(weight > 0, total / np.maximum(weight, 1e-6), np.float32(-LARGEST_LOGIT))


def thread_in(crop: UInt8[np.ndarray, "h w 3"], points: Float64[np.ndarray, "n 2"], network: Promptable) -> Logits:
    """Logits of what is meant by prompts in one crop; the least everywhere where no mask can be thread."""
    masks, scores = network.masks(network.embed(crop), points, np.ones(len(points), bool))
    best_first = np.argsort(-scores, kind="stable")
    if len(masks) > 1:
        # the first of several is made for many prompts, the others for one, which may mean a part or the whole
        others = best_first[best_first != 0]
        best_first = np.append(others, 0) if len(points) == 1 else np.insert(others, 0, 0)
    for number in best_first:
        held = _held(masks[number] > 0, points)
        if held is not None:
            return np.where(held | (masks[number] <= 0), masks[number], np.float32(-LARGEST_LOGIT))
    return np.full(crop.shape[:2], -LARGEST_LOGIT, np.float32)


def _held(mask: Bool[np.ndarray, "h w"], points: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, "h w"] | None:
    """The pieces of a mask that prompts lie on; None where it can be no thread, or not the one that is meant."""
    if not 0 < mask.mean() <= LARGEST_SHARE:
        return None
    labels = np.asarray(cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1], np.int64)
    side = 2 * REACH_PX + 1
    # the greatest number nearby stands for the piece: two pieces so near to each other and to a prompt both count
    around = np.asarray(cv2.dilate(labels.astype(np.float32), np.ones((side, side), np.uint8)), np.int64)
    u, v = np.round(points).astype(np.int64).T
    hit = np.unique(np.concatenate((around[v, u], labels[v, u])))
    if float((around[v, u] > 0).mean()) < LEAST_HIT_SHARE:
        return None
    return np.isin(labels, hit[hit > 0])


def next_centre(pending: Bool[np.ndarray, "h w"], side: int) -> Int64[np.ndarray, "2"] | None:
    """The row and column, among pixels that wait to be looked at, around which most of them lie; None without any."""
    if not pending.any():
        return None
    window = max(1, round((1 - 2 * MARGIN_SHARE) * side))
    around = cv2.boxFilter(
        pending.astype(np.float32), -1, (window, window), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    return np.array(np.unravel_index(int(np.argmax(np.where(pending, around, -1.0))), pending.shape))


def boxes(
    centre: Int64[np.ndarray, "2"], side: int, shape: tuple[int, ...]
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Rows and columns of a crop around a pixel, moved into the image, and of what counts as looked at in it."""
    margin = round(MARGIN_SHARE * side)
    outer: list[slice] = []
    inner: list[slice] = []
    for at, length in zip(centre.tolist(), shape[:2], strict=True):
        first = min(max(at - side // 2, 0), max(length - side, 0))
        last = min(first + side, length)
        outer.append(slice(first, last))
        inner.append(slice(first + margin if first > 0 else 0, last - margin if last < length else length))
    return (outer[0], outer[1]), (inner[0], inner[1])


def _certainty(box: tuple[slice, slice], shape: tuple[int, ...], side: int) -> Float32[np.ndarray, "h w"]:
    """How much a crop counts: fully a margin away from its border, hardly at it, and fully at the image's own."""
    margin = max(1.0, MARGIN_SHARE * side)
    ramps = [
        np.minimum(
            np.arange(1, part.stop - part.start + 1) if part.start > 0 else np.inf,
            np.arange(part.stop - part.start, 0, -1) if part.stop < length else np.inf,
        )
        * np.ones(part.stop - part.start)
        for part, length in zip(box, shape[:2], strict=True)
    ]
    return np.clip(np.minimum(ramps[0][:, None], ramps[1]) / margin, 0.0, 1.0).astype(np.float32)
