"""From the ridge in the reduced image to the thread's pixels in the full one, where alone its width shows."""

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8

EDGE_SHARE = 0.6
"""Of the contrast in the thread's middle: its edge. Blur and shadow widen the thread, so more than one half."""
BLUR_MARGIN_PX = 24
"""Around the ridge: more than three times as far as the blur of its contrast reaches."""
MEAN_OF_CHANNELS = np.full((1, 3), 1 / 3, np.float32)
EIGHT_NEIGHBOURS = np.ones((3, 3), np.uint8)


def at_full_size(
    image: UInt8[np.ndarray, "H W 3"],
    background: UInt8[np.ndarray, "h w 3"],
    ridge: Bool[np.ndarray, "h w"],
    contrast: Float32[np.ndarray, "h w"],
    is_bright: bool,
) -> UInt8[np.ndarray, "H W"]:
    """The thread's pixels in the full image: beside the ridge, with enough of the contrast of its middle.

    Background, ridge and contrast are of the whole reduced image, of which only what lies around the ridge is enlarged.
    """
    coverage = np.zeros(image.shape[:2], np.uint8)
    if not ridge.any():
        return coverage
    (rows, full_rows), (columns, full_columns) = (
        _around(np.flatnonzero(ridge.any(axis=1 - axis)), ridge.shape[axis], image.shape[axis]) for axis in (0, 1)
    )
    background, ridge, contrast = (whole[rows, columns] for whole in (background, ridge, contrast))
    image = image[full_rows, full_columns]
    middle = cv2.dilate(np.where(ridge, contrast, np.float32(0)), EIGHT_NEIGHBOURS)
    level = cv2.GaussianBlur(middle * ridge, (0, 0), 2.0) / np.maximum(
        cv2.GaussianBlur(ridge.astype(np.float32), (0, 0), 2.0), 1e-3
    )
    size = image.shape[1::-1]
    wide = cv2.dilate(255 * ridge.astype(np.uint8), EIGHT_NEIGHBOURS)
    beside = cv2.resize(wide, size, interpolation=cv2.INTER_NEAREST)
    edge = EDGE_SHARE * cv2.resize(level, size, interpolation=cv2.INTER_LINEAR)
    full_background = cv2.resize(background, size, interpolation=cv2.INTER_LINEAR)
    pixel = np.flatnonzero(beside)
    seen, ground = (part.reshape(-1, 1, 3)[pixel] for part in (image, full_background))
    lighter, darker = (seen, ground) if is_bright else (ground, seen)
    clear = mean_excess(lighter, darker)[:, 0] > edge.ravel()[pixel]
    part = np.zeros(image.shape[:2], np.uint8)
    part.ravel()[pixel[clear]] = 255
    coverage[full_rows, full_columns] = part
    return coverage


def _around(hit: Int64[np.ndarray, "n"], reduced: int, full: int) -> tuple[slice, slice]:
    """Where some places lie along one axis, with a margin, in the reduced and in the full image.

    Both begin and end at a border between pixels that the two have in common, so that what is enlarged is what it would
    be in the whole.
    """
    common = math.gcd(reduced, full)
    unit, full_unit = reduced // common, full // common
    first = max(0, int(hit[0]) - BLUR_MARGIN_PX) // unit
    last = -(-min(reduced, int(hit[-1]) + 1 + BLUR_MARGIN_PX) // unit)
    return slice(first * unit, last * unit), slice(first * full_unit, last * full_unit)


def mean_excess(image: np.ndarray, other: np.ndarray) -> Float32[np.ndarray, "h w"]:
    """How much brighter an image is than the other, the mean over the channels of what is above 0."""
    return cv2.transform(cv2.subtract(image, other).astype(np.float32), MEAN_OF_CHANNELS).astype(np.float32, copy=False)
