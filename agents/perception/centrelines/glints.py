"""Glints: holes in the mask of one strand, where light reflects, as opposed to the ground seen through a loop.

Left open, the two sides of a strand would pass for two strands.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8

WIDENING, LONGEST = 2.0, 8.0
"""Of the usual width: what a strand with a filled glint may measure; of its square: the area of the largest glint."""


def without_glints(mask: Bool[np.ndarray, "h w"]) -> tuple[Bool[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """The mask with holes filled that lie within a single strand, and its distance transform."""
    depth = depth_of(mask)
    # over a strip the distance to the nearest pixel beyond its edge averages a quarter of its width, and a half
    usual = max(1.0, 4.0 * mean_depth(depth, mask) - 2.0)
    # an outline of a hole runs on the mask's pixels: around a hole one pixel wide it encloses twice its area
    holes = _short_holes(mask, 2 * LONGEST * usual**2)
    left, top, columns, rows = cv2.boundingRect(holes)
    if columns == 0:
        return mask, depth
    margin = round(WIDENING * usual) + 2
    box = np.s_[max(0, top - margin) : top + rows + margin, max(0, left - margin) : left + columns + margin]
    glints = _glints(mask[box], holes[box] > 0, usual)
    if not glints.any():
        return mask, depth
    filled = mask.copy()
    filled[box] |= glints
    return filled, depth_of(filled)


def mean_depth(depth: Float32[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]) -> float:
    """Over the mask, beyond which there is none: a quarter of the width of a strip."""
    return cv2.sumElems(depth)[0] / cv2.countNonZero(mask.view(np.uint8))


def _glints(mask: Bool[np.ndarray, "h w"], holes: Bool[np.ndarray, "h w"], usual: float) -> Bool[np.ndarray, "h w"]:
    """Those holes around which the mask is no wider than one strand; beside a gap between two it is twice that."""
    count, labelled = cv2.connectedComponents(holes.view(np.uint8), connectivity=8)
    labels = np.asarray(labelled, np.int32)
    pixel = np.flatnonzero(holes)
    of_pixel = labels.ravel()[pixel]
    # a strand may have several side by side, so that all are filled before each is looked at; distances count from
    # pixel to pixel, so that a strip of one pixel has 1
    width = _largest(2 * depth_of(mask | holes).ravel()[pixel] - 1, of_pixel, count)
    glint = (width <= WIDENING * usual) & (np.bincount(of_pixel, minlength=count) <= LONGEST * usual**2)
    glint[0] = False
    return np.asarray(glint[labels], bool)


def _largest(values: Float32[np.ndarray, "p"], of: Int32[np.ndarray, "p"], count: int) -> Float64[np.ndarray, "c"]:
    largest = np.zeros(count)
    np.maximum.at(largest, of, values)
    return largest


def depth_of(mask: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Distance of each pixel of a mask to the nearest one outside; beyond the image all is outside."""
    padded = cv2.copyMakeBorder(mask.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 3), np.float32)[1:-1, 1:-1]


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
