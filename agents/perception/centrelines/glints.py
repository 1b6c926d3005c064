"""Glints: holes in the mask of one strand, where light reflects, as opposed to the ground seen through a loop.

A needle is several times as wide as the thread that hangs on it, and shines: its mask then has a long narrow hole along
it. Left open, its two sides would pass for two strands.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8

WIDEST_STRAND = 4.0
"""Of the usual width: what a needle measures at most."""
WIDEST_SHARE, LONGEST = 0.5, 8.0
"""Of the strand's width there: how wide a glint may be; of its square: how large."""
WIDENING = 2.0
"""Of the usual width: a strand up to so wide may be any thread that is taken for wider than it is."""
SOLID_SHARE = 0.75
"""Of the strand's width: how wide it is somewhere beside a glint, without a hole; two strands that meet are not."""
ENDS_OF_A_STRAND = 2
AROUND = 3.0
"""Of the strand's width: how far around a glint it is looked how many strands lead away from it."""
CROSS, SQUARE = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), np.ones((3, 3), np.uint8)


def without_glints(mask: Bool[np.ndarray, "h w"]) -> tuple[Bool[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """The mask with holes filled that lie within a single strand, and its distance transform."""
    depth = distance_inside(mask)
    usual = _width(mask, depth)
    holes = _short_holes(mask, 2 * LONGEST * (WIDEST_SHARE * WIDEST_STRAND * usual) ** 2)
    left, top, columns, rows = cv2.boundingRect(holes)
    if columns == 0:
        return mask, depth
    margin = round(AROUND * WIDEST_STRAND * usual) + 2
    box = np.s_[max(0, top - margin) : top + rows + margin, max(0, left - margin) : left + columns + margin]
    glints = _glints(mask[box], holes[box] > 0, usual)
    if not glints.any():
        return mask, depth
    filled = mask.copy()
    filled[box] |= glints
    return filled, distance_inside(filled)


def _glints(mask: Bool[np.ndarray, "h w"], holes: Bool[np.ndarray, "h w"], usual: float) -> Bool[np.ndarray, "h w"]:
    """Those holes of a mask that are glints of a strand."""
    count, labelled = cv2.connectedComponents(holes.view(np.uint8), connectivity=8)
    labels = np.asarray(labelled, np.int32)
    pixel = np.flatnonzero(holes)
    of_pixel = labels.ravel()[pixel]
    # distances count from pixel to pixel, so that a strip of one pixel has 1
    gap = _largest(2 * distance_inside(holes).ravel()[pixel] - 1, of_pixel, count)
    narrow = gap <= WIDEST_SHARE * WIDEST_STRAND * usual
    narrow[0] = False
    # a needle may have several, so that all are filled before each is looked at
    whole = mask | narrow[labels]
    width = _largest(2 * distance_inside(whole).ravel()[pixel] - 1, of_pixel, count)
    area = np.bincount(of_pixel, minlength=count)
    glint = narrow & (width <= WIDENING * usual) & (area <= LONGEST * usual**2)
    narrow &= (gap <= WIDEST_SHARE * width) & (area <= LONGEST * width**2) & (width <= WIDEST_STRAND * usual)
    solid = distance_inside(mask)
    for k in np.flatnonzero(narrow & ~glint).tolist():
        hole = (labels == k).view(np.uint8)
        beside = cv2.dilate(hole, np.ones((2 * round(width[k]) + 1,) * 2, np.uint8))
        glint[k] = (
            2 * solid[np.asarray(beside) > 0].max() - 1 >= SOLID_SHARE * width[k]
            and _strands_away(hole > 0, whole, round(AROUND * width[k])) <= ENDS_OF_A_STRAND
        )
    return np.asarray(glint[labels], bool)


def _largest(values: Float32[np.ndarray, "p"], of: Int32[np.ndarray, "p"], count: int) -> Float64[np.ndarray, "c"]:
    largest = np.zeros(count)
    np.maximum.at(largest, of, values)
    return largest


def usual_width(mask: Bool[np.ndarray, "h w"]) -> float:
    """How wide the strands of a mask are on average, in pixels, 1 at least."""
    return _width(mask, distance_inside(mask))


def distance_inside(mask: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Distance of each pixel of a mask to the nearest one outside; beyond the image all is outside."""
    padded = np.pad(mask, 1).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 3), np.float32)[1:-1, 1:-1]


def _width(mask: Bool[np.ndarray, "h w"], depth: Float32[np.ndarray, "h w"]) -> float:
    # over a strip the distance to the nearest pixel beyond its edge averages a quarter of its width, and a half
    return max(1.0, 4.0 * float(depth[mask].mean()) - 2.0)


def _short_holes(mask: Bool[np.ndarray, "h w"], largest: float) -> UInt8[np.ndarray, "h w"]:
    """The holes of a mask with outlines around no more than that area, as 1."""
    image = mask.view(np.uint8)
    outlines, hierarchy = cv2.findContours(image, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    outer = np.asarray(hierarchy, np.int64).reshape(-1, 4)[:, 3]
    short = [outlines[k] for k in np.flatnonzero(outer >= 0).tolist() if cv2.contourArea(outlines[k]) <= largest]
    holes = np.zeros(mask.shape, np.uint8)
    if short:
        cv2.drawContours(holes, short, -1, 1, cv2.FILLED)
        holes &= 1 - image
    return holes


def _strands_away(glint: Bool[np.ndarray, "h w"], whole: Bool[np.ndarray, "h w"], reach: int) -> int:
    """How many strands of a mask lead away from a hole in it, farther than `reach` within the mask."""
    left, top, columns, rows = cv2.boundingRect(glint.view(np.uint8))
    margin = reach + 2
    around = np.s_[max(0, top - margin) : top + rows + margin, max(0, left - margin) : left + columns + margin]
    near, mask = glint[around].astype(np.uint8), whole[around].astype(np.uint8)
    for step in range(reach):
        near = np.asarray(cv2.dilate(near, SQUARE if step % 2 else CROSS), np.uint8) & mask
    rim = np.asarray(cv2.dilate(near, SQUARE), np.uint8) & mask & (1 - near)
    return cv2.connectedComponents(rim, connectivity=8)[0] - 1
