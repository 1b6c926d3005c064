"""What is looked at of an image while ridges are looked for: all of it, reduced, or what lies near a known thread."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from agents.perception.segmentation.near import Meant, Near
from benchmarks.ridge.colour import Rare, rare_in
from benchmarks.ridge.instrument_edges import Instruments, instruments_in
from benchmarks.ridge.line_filter import RADIUS_PX

DETECTION_WIDTH_PX = 480
"""Width of the reduced image; the sizes in pixels below are of this image."""
BACKGROUND_STEP, BACKGROUND_WINDOW = 3, 5
"""The local background is the median of so many pixels to a side, each as large as so many here: several times the
thread's width. Medians of more pixels take ten times as long."""
RARE_STEP = 6
"""One pixel of so many in either direction tells which colours are rare."""
STRONG_SHARE = 0.003
"""Of the image's pixels: its strongest ridges."""
CROP_MARGIN_PX = BACKGROUND_STEP * -(-(RADIUS_PX + BACKGROUND_STEP * BACKGROUND_WINDOW) // BACKGROUND_STEP)
"""Around what is looked at: far enough for the filters and for the background to see what they see in a whole image.
A multiple of the background's step, so that the image for it is reduced alike."""


@dataclass(frozen=True)
class View:
    """What is looked at of the reduced image.

    Fields:
        shape: of the reduced image.
        rows, columns: where it lies in that.
        near: which pixels of it may be thread; all, if it is None.
        meant: which of its ridges is.
        strong: how many pixels of the whole image are among its strongest.
        rare: what makes a colour of the whole image rare.
        instruments: in it; None where none are known.
    """

    shape: tuple[int, int]
    rows: slice
    columns: slice
    near: Bool[np.ndarray, "h w"] | None
    meant: Meant | None
    strong: float
    seen: UInt8[np.ndarray, "h w 3"]
    background: UInt8[np.ndarray, "h w 3"]
    rare: Rare
    instruments: Instruments | None


def _reduced(image: np.ndarray, share: float) -> np.ndarray:
    size = (max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def view_of(image: UInt8[np.ndarray, "h w 3"], near: Near | None, meant: Meant | None) -> View:
    """What is looked at of an image, with what the whole of it tells."""
    reduced = _reduced(image, min(1.0, DETECTION_WIDTH_PX / image.shape[1]))
    small = None
    if near is not None:
        small = (
            np.asarray(cv2.resize(near.where.view(np.uint8), reduced.shape[1::-1], interpolation=cv2.INTER_NEAREST)) > 0
        )
        # a place that falls between the pixels of the reduced image is looked at all the same
        small = small if small.any() else np.ones(small.shape, bool)
    rows, columns = _box(small, reduced.shape)
    seen = reduced[rows, columns]
    if meant is not None:
        weight = cv2.resize(meant.weight, reduced.shape[1::-1], interpolation=cv2.INTER_AREA)
        meant = Meant(np.asarray(weight)[rows, columns], meant.alone)
    instruments = None if meant is not None else instruments_in(reduced)
    return View(
        shape=reduced.shape[:2],
        rows=rows,
        columns=columns,
        near=None if small is None else small[rows, columns],
        meant=meant,
        strong=STRONG_SHARE * (reduced.shape[0] * reduced.shape[1] - 1),
        seen=seen,
        background=_background(seen),
        rare=rare_in(np.ascontiguousarray(reduced[::RARE_STEP, ::RARE_STEP])),
        instruments=None if instruments is None else instruments.part(rows, columns),
    )


def _box(near: Bool[np.ndarray, "h w"] | None, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The rows and columns of the reduced image that hold everything near, with a margin."""
    if near is None:
        return slice(0, shape[0]), slice(0, shape[1])
    sides: list[slice] = []
    for axis, size in ((1, shape[0]), (0, shape[1])):
        hit = np.flatnonzero(near.any(axis=axis))
        first = max(0, int(hit[0]) - CROP_MARGIN_PX)
        last = min(size, int(hit[-1]) + CROP_MARGIN_PX + 1)
        sides.append(slice(first - first % BACKGROUND_STEP, min(size, last + -last % BACKGROUND_STEP)))
    return sides[0], sides[1]


def _background(image: UInt8[np.ndarray, "h w 3"]) -> np.ndarray:
    height, width = image.shape[:2]
    size = max(1, width // BACKGROUND_STEP), max(1, height // BACKGROUND_STEP)
    median = cv2.medianBlur(cv2.resize(image, size, interpolation=cv2.INTER_AREA), BACKGROUND_WINDOW)
    return cv2.resize(median, (width, height), interpolation=cv2.INTER_LINEAR)


def in_whole(part: np.ndarray, view: View) -> np.ndarray:
    """What was found in a part of the reduced image, in the whole of it, with nothing around."""
    if part.shape[:2] == view.shape:
        return part
    whole = np.zeros((*view.shape, *part.shape[2:]), part.dtype)
    whole[view.rows, view.columns] = part
    return whole
