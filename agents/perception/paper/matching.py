"""Matching of segmented pixels along rows, and the rejection of ambiguous matches (paper, section II-B).

A left pixel p is compared with the segmented pixels q of its row in the right image, at disparity δ = p_u − q_u, by

    E(p, δ) = Σ_w ‖I_left(p + w) − I_right(p + w − δ)‖²,

the sum over the segmented left pixels p + w of a small window; one that falls beside the right thread costs a
constant. E1 is the least cost, E2 the least one outside the peak around E1. A match counts where the second peak is
clearly worse (eq. 2).
"""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.perception.paper.clustering import neighbour_matrix

REFERENCE_WIDTH_PX = 640
"""The image width at which the paper's sizes in pixels hold; they scale with the width."""
WINDOW_RADIUS_PX = 2
MAXIMUM_DISPARITY_PX = 80
PEAK_HALF_WIDTH_PX = 2
LEAST_COST = 1e-6
"""Guards a perfect match, whose cost is 0, against division."""
EPSILON = (8.0, 5.0, 0.8, 0.9)
"""ε1 to ε4 of the outlier metric."""
GREATEST_SQUARE = 3 * 255.0**2
SQUARE_OFF_THREAD = GREATEST_SQUARE / 4
"""What a segmented left pixel costs where the right one is not segmented. Compared with the ground instead, pixels at
the thread's edge agree best with the ground behind it, and disparities come out a third of a pixel too small."""
LARGEST_BLOCK = 4_000_000
"""Pixels times disparities that are looked at together; 100 bytes each while they are."""


@dataclass(frozen=True)
class Matches:
    """The best disparity of each segmented left pixel that has any candidate.

    Fields:
        pixel: row and column in the left image.
        disparity_px: of the best candidate.
        cost: E1 and E2; a pixel without a second candidate has the greatest possible cost there.
    """

    pixel: Int64[np.ndarray, "p 2"]
    disparity_px: Float64[np.ndarray, "p"]
    cost: Float64[np.ndarray, "p 2"]


def scaled_px(size_px: int, image_width: int) -> int:
    """A size in pixels that holds at the reference width, at this width; at least 1."""
    return max(1, round(size_px * image_width / REFERENCE_WIDTH_PX))


def searched_disparities(image_width: int, shown_px: Float64[np.ndarray, "2"] | None = None) -> range:
    """The disparities that are looked at: what the pair shows, where it shows more than the paper looks at.

    Args:
        shown_px: least and greatest disparity of thread, as far as the pair shows them.
    """
    usual = range(1, scaled_px(MAXIMUM_DISPARITY_PX, image_width) + 1)
    if shown_px is None or not usual.stop < shown_px[1] <= image_width:
        return usual
    return range(max(1, int(shown_px[0])), int(shown_px[1]) + 1)


def match_pixels(
    left: UInt8[np.ndarray, "h w 3"],
    right: UInt8[np.ndarray, "h w 3"],
    segmented_left: Bool[np.ndarray, "h w"],
    segmented_right: Bool[np.ndarray, "h w"],
    searched: range | None = None,
) -> Matches:
    """Match every segmented left pixel along its row of the right image, both images rectified.

    Args:
        searched: disparities that are looked at; those of the paper, if it is None.
    """
    searched = searched or searched_disparities(left.shape[1])
    radius = scaled_px(WINDOW_RADIUS_PX, left.shape[1])
    parts: list[Matches] = []
    for first, last in _row_blocks(segmented_left, len(searched)):
        top = max(0, first - radius)
        rows = slice(top, last + radius)
        part = _match_block(left[rows], right[rows], segmented_left[rows], segmented_right[rows], searched)
        own = (part.pixel[:, 0] >= first - top) & (part.pixel[:, 0] < last - top)
        parts.append(Matches(part.pixel[own] + (top, 0), part.disparity_px[own], part.cost[own]))
    if not parts:
        return Matches(np.zeros((0, 2), np.int64), np.zeros(0), np.zeros((0, 2)))
    return Matches(
        np.concatenate([part.pixel for part in parts]),
        np.concatenate([part.disparity_px for part in parts]),
        np.concatenate([part.cost for part in parts]),
    )


def _row_blocks(segmented: Bool[np.ndarray, "h w"], disparities: int) -> list[tuple[int, int]]:
    """First and one-past-last rows of blocks that together hold all segmented pixels, none of them too large."""
    ends = np.cumsum(segmented.sum(axis=1))
    most = max(1, LARGEST_BLOCK // disparities)
    blocks: list[tuple[int, int]] = []
    first = int(np.searchsorted(ends, 0, side="right"))
    while first < len(ends):
        before = int(ends[first - 1]) if first else 0
        last = max(first + 1, int(np.searchsorted(ends, before + most, side="right")))
        blocks.append((first, last))
        first = last + int(np.searchsorted(ends[last:], ends[last - 1], side="right"))
    return blocks


def _match_block(
    left: np.ndarray, right: np.ndarray, segmented_left: np.ndarray, segmented_right: np.ndarray, searched: range
) -> Matches:
    """All candidates of all segmented left pixels at once: arrays of pixels by disparities.

    Off the thread every pixel of a window costs the same, so only where one falls on the thread is anything looked up:
    those few are a sparse matrix of what they save, which the window sums.
    """
    width = left.shape[1]
    radius = scaled_px(WINDOW_RADIUS_PX, width)
    pixel = np.argwhere(segmented_left)
    onto_thread = _seen_by(pixel, segmented_right, searched)
    window = neighbour_matrix(pixel, left.shape[:2], radius)
    in_window = np.diff(window.indptr).astype(np.float64)[:, None]

    square = (2 * radius + 1,) * 2
    candidate = _seen_by(pixel, cv2.dilate(segmented_right.astype(np.uint8), np.ones(square, np.uint8)), searched)
    cost = (window @ -_saved(left, right, pixel, onto_thread, searched.start)).toarray()
    cost += SQUARE_OFF_THREAD * in_window
    np.copyto(cost, GREATEST_SQUARE * in_window, where=~candidate)
    return _best_two(pixel, cost, onto_thread, searched.start, scaled_px(PEAK_HALF_WIDTH_PX, width))


def _seen_by(pixel: Int64[np.ndarray, "p 2"], mask: np.ndarray, searched: range) -> Bool[np.ndarray, "p d"]:
    """The mask of the right image at each left pixel's column less each disparity; nothing left of the image."""
    height, width = mask.shape
    most = searched.stop - 1
    padded = np.zeros((height, width + most), bool)
    padded[:, most:] = mask
    # the window that ends before the pixel by the least disparity, walked from its end
    before = np.lib.stride_tricks.sliding_window_view(padded, len(searched), axis=1)[:, :, ::-1]
    return before[pixel[:, 0], pixel[:, 1]]


def _saved(
    left: np.ndarray,
    right: np.ndarray,
    pixel: Int64[np.ndarray, "p 2"],
    onto_thread: Bool[np.ndarray, "p d"],
    least: int,
) -> scipy.sparse.csr_matrix:
    """By how much each pixel's own square at each disparity is less than off the thread: (p, d)."""
    disparities, count = onto_thread.shape[1], np.count_nonzero(onto_thread, axis=1)
    index = np.flatnonzero(onto_thread).astype(np.int32) % disparities
    place = (pixel[:, 0] * left.shape[1] + pixel[:, 1]).astype(np.int32)
    at_right = np.repeat(place - least, count) - index
    square = np.zeros(len(index), np.int32)
    for channel in range(3):
        seen_left = np.repeat(left[:, :, channel].ravel()[place].astype(np.int32), count)
        difference = seen_left - right[:, :, channel].ravel()[at_right]
        square += difference * difference
    indptr = np.concatenate(([0], np.cumsum(count)))
    return scipy.sparse.csr_matrix((SQUARE_OFF_THREAD - square, index, indptr), shape=onto_thread.shape)


def is_inlier(cost: Float64[np.ndarray, "p 2"]) -> Bool[np.ndarray, "p"]:
    """Whether the second peak is clearly worse than the first (eq. 2, with ε3 outside the denominator).

    The sigmoid exceeds ε4 where its argument exceeds ln(ε4 / (1 − ε4)), so that E2 > 6.4 E1.
    """
    e1, e2, e3, e4 = EPSILON
    best, second = np.maximum(cost[:, 0], LEAST_COST), cost[:, 1]
    return e1 * ((second - best) / (e2 * best) - e3) > np.log(e4 / (1 - e4))


def _best_two(
    pixel: np.ndarray,
    cost: Float64[np.ndarray, "p d"],
    segmented: Bool[np.ndarray, "p d"],
    least: int,
    peak_half_width: int,
) -> Matches:
    """The best segmented candidate of each pixel, and the least cost outside its peak."""
    has_match = segmented.any(axis=1)
    pixel, cost, segmented = pixel[has_match], cost[has_match], segmented[has_match]
    best = np.argmin(np.where(segmented, cost, np.inf), axis=1)
    every = np.arange(len(pixel))
    first, count = cost[every, best], cost.shape[1]
    peak = best[:, None] + np.arange(-peak_half_width, peak_half_width + 1)
    cost[every[:, None], np.clip(peak, 0, count - 1)] = np.inf
    second = cost.min(axis=1, initial=np.inf)
    greatest = np.maximum(first, GREATEST_SQUARE * count)
    both = np.column_stack((first, np.where(np.isfinite(second), second, greatest)))
    return Matches(pixel, (best + least).astype(np.float64), both)
