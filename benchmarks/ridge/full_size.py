"""From the ridge in the reduced image to the thread's pixels in the full one, where alone its width shows."""

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

EDGE_SHARE = 0.6
"""Of the contrast in the thread's middle: its edge. Blur and shadow widen the thread, so more than one half."""
BLUR_PX, BLUR_SIDE_PX = 2.0, 13
"""Standard deviation and window in which the contrast of the middle is averaged."""
BLUR_MARGIN_PX = BLUR_SIDE_PX // 2 + 2
"""Around the ridge: as far as the blur of its contrast is seen beside it."""
SHEET = 256
GLINT_SHARE, MOST_IN_SPECKS = 0.03, 0.25
"""Of the image's width: bright pieces up to that long are glints on wet tissue. Of the thread: if more of it lies in
such pieces, it is a thread that shows in pieces."""
SHINE = 1.0
"""Pixels of the reduced image to either side of the middle of a streak of light along a dark thread: what lies between
its dark edges is thread too where it is as unlike the ground as they are, or they are edges of a single strand."""
WIDENING = 2.0
"""Of the usual width: what a strand with a streak of light may measure."""
HOLLOW, OTHER_SHARE = 1.5, 0.3
"""Where only the two sides of a strand are covered nearly everywhere: the same, of the width with all gaps closed; and
how unlike the ground a streak is at least, as a share of what the thread's edge is."""
LEAST_EDGE = 1e-3
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
    full_size = full_columns.stop - full_columns.start, full_rows.stop - full_rows.start
    wide = cv2.dilate(np.ascontiguousarray(ridge).view(np.uint8), EIGHT_NEIGHBOURS)
    pixel = np.flatnonzero(cv2.resize(wide, full_size, interpolation=cv2.INTER_NEAREST).view(bool))
    row, column = np.divmod(pixel, full_size[0])
    share = ridge.shape[1] / full_size[0], ridge.shape[0] / full_size[1]
    # where the middle of each pixel lies in the reduced image
    place = (column + 0.5) * share[0] - 0.5, (row + 0.5) * share[1] - 0.5
    edge = EDGE_SHARE * _at(_level(ridge, contrast), place)
    ground = np.asarray(_at(background, place), np.uint8)
    of_image = (full_rows.start + row) * image.shape[1] + full_columns.start + column
    # NumPy takes from one axis four times as fast as from two
    seen = image.reshape(-1, 3).take(of_image, axis=0)
    lighter, darker = (seen, ground) if is_bright else (ground, seen)
    excess = mean_excess(lighter[None], darker[None])[0]
    clear = excess > edge
    if not clear.any():
        return coverage
    coverage.ravel()[of_image[clear]] = 255
    part = coverage[full_rows, full_columns]
    if is_bright:
        coverage[full_rows, full_columns] = without_specks(part, GLINT_SHARE * image.shape[1])
        return coverage
    unlike = np.zeros(part.size, np.float32)
    unlike[pixel] = (excess + mean_excess(darker[None], lighter[None])[0]) / np.maximum(edge, np.float32(LEAST_EDGE))
    filled = _streaks(part, 1 / share[0], unlike)
    part[np.divmod(filled, part.shape[1])] = 255
    return coverage


def _streaks(
    coverage: UInt8[np.ndarray, "h w"], pixels: float, unlike: Float32[np.ndarray, "a"]
) -> Int64[np.ndarray, "p"]:
    """Gaps of up to so many pixels to either side that are streaks of light along a single strand: their pixels.

    Args:
        unlike: how unlike the ground each pixel is, as a share of what the thread's edge is.
    """
    left, top, columns, rows = cv2.boundingRect(coverage)
    radius = round(SHINE * pixels)
    margin = 2 * radius + 1
    box = coverage[top : top + rows, left : left + columns]
    covered = cv2.copyMakeBorder(box, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=0)
    closed = _closed(covered, radius)
    gaps = cv2.subtract(closed, covered)
    pixel = np.flatnonzero(gaps.view(bool))
    row, column = np.divmod(pixel, covered.shape[1])
    inside = (row + (top - margin)) * coverage.shape[1] + column + (left - margin)
    of_gap = unlike[inside]
    width = _width_with_gaps(covered, gaps, pixel, radius)
    narrow = width <= WIDENING * _usual_width(covered)
    doubtful = ~narrow & (of_gap > OTHER_SHARE)
    if doubtful.any():
        # as a strand is of which only two sides are covered
        narrow |= doubtful & (width <= HOLLOW * _usual_width(closed))
    return inside[narrow | (of_gap > 1)]


def _width_with_gaps(
    covered: UInt8[np.ndarray, "h w"], gaps: UInt8[np.ndarray, "h w"], pixel: Int64[np.ndarray, "p"], radius: int
) -> Float64[np.ndarray, "p"]:
    """How wide what is covered is with the gap that each pixel belongs to."""
    count, labelled = cv2.connectedComponents(gaps, connectivity=8)
    of, width = np.asarray(labelled, np.int32).ravel()[pixel], np.zeros(count)
    # where two strands part, the gap is closed further on, so that its end does not make them look narrow
    further = _closed(covered, 2 * radius)
    np.maximum.at(width, of, 2 * cv2.distanceTransform(further, cv2.DIST_L2, 3).ravel()[pixel] - 1)
    return width[of]


def _usual_width(coverage: UInt8[np.ndarray, "h w"]) -> float:
    """Over a strip the distance to the nearest pixel beyond its edge averages a quarter of its width, and a half."""
    depth = cv2.distanceTransform(coverage, cv2.DIST_L2, 3)
    return max(1.0, 4.0 * cv2.sumElems(depth)[0] / cv2.countNonZero(coverage) - 2.0)


def _closed(coverage: UInt8[np.ndarray, "h w"], radius: int) -> UInt8[np.ndarray, "h w"]:
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.morphologyEx(coverage, cv2.MORPH_CLOSE, around), np.uint8)


def without_specks(coverage: UInt8[np.ndarray, "h w"], longest_px: float) -> UInt8[np.ndarray, "h w"]:
    """Coverage without its pieces up to that long, unless much of the thread would go with them."""
    _, labelled, stats, _ = cv2.connectedComponentsWithStats(coverage, connectivity=8)
    kept = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) > longest_px
    kept[0] = False
    area = stats[1:, cv2.CC_STAT_AREA]
    if area[~kept[1:]].sum() > MOST_IN_SPECKS * area.sum():
        return coverage
    return np.where(kept[np.asarray(labelled, np.int32)], coverage, np.uint8(0))


def _level(ridge: Bool[np.ndarray, "h w"], contrast: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """The contrast of the ridge's middle, averaged along it and carried on beside it."""
    on_ridge = ridge.astype(np.float32)
    middle = cv2.multiply(cv2.dilate(cv2.multiply(contrast, on_ridge), EIGHT_NEIGHBOURS), on_ridge)
    total, count = (cv2.GaussianBlur(part, (BLUR_SIDE_PX, BLUR_SIDE_PX), BLUR_PX) for part in (middle, on_ridge))
    np.maximum(count, np.float32(1e-3), out=count)
    return np.asarray(cv2.divide(total, count, dst=total), np.float32)


def _at(image: np.ndarray, place: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The image at places (columns, rows) between its pixels."""
    count = len(place[0])
    # OpenCV takes no more than 32767 of them in a row
    sheet = np.zeros((2, -(-count // SHEET), SHEET), np.float32)
    for axis, values in enumerate(place):
        sheet[axis].ravel()[:count] = values
    found = np.asarray(cv2.remap(image, sheet[0], sheet[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    return found.reshape(-1, *found.shape[2:])[:count]


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
