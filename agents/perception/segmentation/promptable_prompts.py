"""Where a promptable network is pointed to: at a person's pixel, at thread that another segmenter found, or, in the eye
in which nobody pointed, at what lies in the rows of the thread that the other eye shows and looks like it.
"""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from agents.perception.segmentation.boxes import Meant, Near
from agents.perception.segmentation.network import segment_network

MOST_POINTS = 8
"""Prompts in one crop."""
CREST_SHARE = 0.8
"""Of the greatest weight: where the thread of the frame before most likely lies."""
ALIKE_SHARE = 0.3
"""Of the likeness to the thread's colour from which a pixel may be prompted at."""
LARGEST_DISPARITY_SHARE = 0.125
"""Of the width, as where pixels are matched."""
MOST_MATCHED = 4000
"""Pixels of the thread that are sought in the other eye's rows."""
STRETCH_SHARE = 0.0625
"""Of the width: side of the cells in which the thread has one disparity."""
DISPARITY_SPREAD_SHARE = 0.01
"""Of the width: how far the disparities of stretches lie apart, one deviation."""


def pointed_at(
    image: UInt8[np.ndarray, "h w 3"], near: Near | None = None, meant: Meant | None = None
) -> Iterator[Bool[np.ndarray, "h w"]]:
    """Pixels in the middle of what may be the thread, one guess after the other, each for where those before find none.

    Args:
        near: where thread was; what the network finds there are prompts.
        meant: alone and without `near`, a person's pixel, where its weight is greatest, and the thread next to it; with
            what covers the other eye, the thread there; else which thread is.
    """
    if meant is not None and not meant.weight.any():
        return
    if meant is not None and near is None and meant.other_eye is not None:
        yield middle_of(in_rows_of(meant.other_eye, meant.weight))
        return
    if meant is not None and near is None and meant.alone:
        pixel = np.zeros(image.shape[:2], bool)
        pixel.ravel()[int(np.argmax(meant.weight))] = True
        yield pixel
    yield middle_of(segment_network(image, near, meant) > 0)
    if meant is not None and near is not None:
        yield middle_of(meant.weight > CREST_SHARE * meant.weight.max())


def in_rows_of(other: UInt8[np.ndarray, "h w"], alike: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Where the right eye shows the thread that the left one's coverage shows, by its rows and its colour.

    Every stretch of the thread is laid over the right image at each disparity; where all stretches together, and it
    among them, look most like the thread, it is.

    Args:
        other: coverage in the left eye.
        alike: how much each pixel of this eye looks like the thread, 0 to 1.
    """
    width = alike.shape[1]
    pixel = np.argwhere(middle_of(other > 0))
    pixel = pixel[:: -(-len(pixel) // MOST_MATCHED) or 1]
    here = np.zeros(alike.shape, bool)
    if len(pixel) == 0:
        return here
    disparity = np.arange(1, max(2, round(LARGEST_DISPARITY_SHARE * width)) + 1)
    stretch = _stretch_of(pixel, width)
    column = pixel[:, 1, None] - disparity
    seen = np.where(column >= 0, alike[pixel[:, 0, None], np.maximum(column, 0)], np.float32(0))
    of_stretch = np.zeros((int(stretch.max()) + 1, len(disparity)))
    np.add.at(of_stretch, stretch, seen)
    # a stretch alone may look like several places; what the whole thread says tells them apart
    spread = max(1.0, DISPARITY_SPREAD_SHARE * width)
    of_all = cv2.GaussianBlur(of_stretch.sum(axis=0)[None], (0, 0), spread, borderType=cv2.BORDER_REPLICATE)[0]
    best = np.argmax(of_stretch * (of_all / max(float(of_all.max()), 1e-9)) ** 2, axis=1)[stretch]
    found = seen[np.arange(len(pixel)), best] > ALIKE_SHARE
    here[pixel[found, 0], column[found, best[found]]] = True
    return here


def _stretch_of(pixel: Int64[np.ndarray, "p 2"], width: int) -> Int64[np.ndarray, "p"]:
    cell = pixel // max(1, round(STRETCH_SHARE * width))
    return np.unique(cell[:, 0] * (width + 1) + cell[:, 1], return_inverse=True)[1]


def middle_of(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The pixels of a mask that lie deepest in it among their neighbours: prompts on an edge may mean either side."""
    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    return mask & (depth >= cv2.dilate(depth, np.ones((3, 3), np.uint8)))


def spread_points(pixel: Int64[np.ndarray, "p 2"], first: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "n 2"]:
    """U and v of some of many pixels (row, column): the nearest to a place, then always the farthest from the rest."""
    at = pixel[:, ::-1].astype(np.float64)
    chosen = [int(np.argmin(np.linalg.norm(at - first, axis=1)))]
    away = np.linalg.norm(at - at[chosen[0]], axis=1)
    while len(chosen) < MOST_POINTS and away.max() > 0:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(at - at[chosen[-1]], axis=1))
    return at[chosen]
