"""Regions of instruments by their hue, found in one image, as perception found them before it had a network.

Tissue reflects red far better than green and blue, and steel and plastic reflect all alike. So the logarithm of red
over the mean of green and blue parts them, whatever the light: a cast moves both by the same. Where the ground itself
is grey, nothing can be told by it, and nothing is.

A grey region is an instrument where it is large, far greyer than the ground, with a sharp border, and reaches out of
the image, as instruments do. What is all that and ends within the image, or has thread upon it, is unknown.
"""

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from schemas.messages import Occluder

WIDTH_PX = 240
"""Of the copy in which regions are looked for."""
DARK = 4.0
"""Added to every channel: of pixels that are nearly black, colour cannot be told."""
STEP = 1 / 64
"""Of redness, between two of its whole numbers."""
ZERO = 80
"""The whole number of what is grey: from a redness of −1.25, less than of any thing, to one of 2.7."""
GLINT = 225
"""Brightness from which a pixel is a glint, which has the colour of the light on tissue and instrument alike."""
LOW_SHARE = 0.015
"""Of the image: so much of it is instrument, and the least red, where there is any."""
LEAST_APART, LEAST_APART_SHARE = 0.08, 0.4
"""Of redness between the ground and an instrument, and as a share of the ground's own."""
LEAST_RED = 0.05
"""Of the ground."""
GREY_SHARE = 0.5
"""Of the ground's redness: more, on the mean, than an instrument has."""
SHARP = 0.6
"""Of the way from an instrument's redness to the ground's: what changes over its border, within 3 px."""
LEAST_AREA_SHARE = 0.004
"""Of the image."""
LEAST_UPON = 6
"""Pixels of thread within a region, beyond its border, from which on thread lies upon it."""

_LOG = np.log(np.arange(256) + DARK) / STEP
_OF_RED, _OF_OTHERS = (_LOG + ZERO).astype(np.float32), _LOG.astype(np.float32)
_CROSS, _WIDE = np.ones((3, 3), np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))
_GAP = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
_BESIDE = len(_WIDE) // 2 + 1


def occluders_in(
    image: UInt8[np.ndarray, "h w 3"], coverage: UInt8[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "r c"] | None:
    """The number of an `Occluder`, or 0, for each pixel of a copy 240 px wide; None where the image does not tell.

    Args:
        coverage: by thread, 0 to 255.
    """
    size = map_shape(image.shape)[::-1]
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    thread = np.asarray(cv2.resize(coverage, size, interpolation=cv2.INTER_AREA)) > 0
    red = redness(small)
    told = ~thread & (_brightest(small) < GLINT)
    order = np.cumsum(cv2.calcHist([red], [0], told.view(np.uint8), [256], [0, 256]).ravel()).astype(np.int64)
    ground, low = (int(np.searchsorted(order, share * order[-1])) - ZERO for share in (0.5, LOW_SHARE))
    if order[-1] == 0 or ground * STEP < LEAST_RED:
        return None
    found = np.zeros(red.shape, np.uint8)
    if (ground - low) * STEP < max(LEAST_APART, LEAST_APART_SHARE * ground * STEP):
        return found
    grey = (red < ZERO + 0.5 * (low + ground)) & told
    # glints and thread upon an instrument are holes in its region, and glints on tissue are specks
    opened = cv2.morphologyEx(grey.view(np.uint8), cv2.MORPH_OPEN, _CROSS)
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, _GAP)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    height, width = red.shape
    for k, (left, top, columns, rows, area) in enumerate(np.asarray(stats).tolist()):
        if k == 0 or area < LEAST_AREA_SHARE * red.size:
            continue
        # with what is looked at beside it
        box = np.s_[max(0, top - _BESIDE) : top + rows + _BESIDE, max(0, left - _BESIDE) : left + columns + _BESIDE]
        region = (np.asarray(labels)[box] == k).view(np.uint8)
        if _is_instrument(region, red[box], told[box], ground, low):
            upon = cv2.countNonZero(cv2.bitwise_and(cv2.erode(region, _WIDE), thread[box].view(np.uint8))) >= LEAST_UPON
            # an instrument reaches out of the image
            leaves = left < 2 or top < 2 or left + columns > width - 2 or top + rows > height - 2
            found[box][region > 0] = (Occluder.UNKNOWN if upon or not leaves else Occluder.TOOL).value
    return found


def map_shape(image_shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of a map of occluders."""
    return max(1, round(image_shape[0] * WIDTH_PX / image_shape[1])), WIDTH_PX


def redness(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """The logarithm of red over the mean of green and blue, in steps of 1/64 about 80."""
    others = np.asarray(cv2.addWeighted(image[..., 0], 0.5, image[..., 1], 0.5, 0.0), np.uint8)
    of_red, of_others = cv2.LUT(cv2.extractChannel(image, 2), _OF_RED), cv2.LUT(others, _OF_OTHERS)
    return np.asarray(cv2.subtract(of_red, of_others, dtype=cv2.CV_8U), np.uint8)


def _brightest(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """The greatest channel of each pixel: over an axis of three, NumPy takes twenty times as long."""
    blue, green, red = cv2.split(image)
    return np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)


def _is_instrument(
    region: UInt8[np.ndarray, "r c"],
    red: UInt8[np.ndarray, "r c"],
    told: Bool[np.ndarray, "r c"],
    ground: int,
    low: int,
) -> bool:
    """Whether a region is far greyer than the ground, and its border sharp."""
    known = told.view(np.uint8)
    mean = cv2.mean(red, cv2.bitwise_and(region, known))[0] - ZERO
    outside = cv2.subtract(cv2.dilate(region, _WIDE), cv2.dilate(region, _CROSS))
    # beyond the image an instrument goes on
    inside = cv2.subtract(cv2.erode(region, _CROSS, borderValue=1), cv2.erode(region, _WIDE, borderValue=1))
    step = cv2.mean(red, cv2.bitwise_and(outside, known))[0] - cv2.mean(red, cv2.bitwise_and(inside, known))[0]
    return mean < GREY_SHARE * ground and step >= SHARP * (ground - low)
