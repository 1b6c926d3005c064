"""Short pieces of the right image that the left one does not show: glints that touch the thread, no thread.

What is thread shows in the same rows of the left image, at about the disparity of all of it. A short piece that does
not is of no use for a match, but beside a gap of the thread it passes for another strand, and keeps what lies beyond
the gap from being one with the rest (`joined`).
"""

import numpy as np
from jaxtyping import Bool, Float64

from schemas.messages import Centrelines
from shared.disparities import Disparities

EVERY = 3
"""Of the points, which lie about a pixel apart."""
ROWS_PX = 4.0
"""Rows of one place in both images lie no farther apart, before it is known by how much they do."""
BINS = 4
"""In which disparities are counted, from the usual one to the farthest from it that may be."""
LONGEST_WIDTHS = 10.0
"""Longer pieces may be thread that something hides from the left eye."""


def without_spurs(left: Centrelines, right: Centrelines, image_width: int, reach: Disparities) -> Centrelines:
    """The right image's pieces without short ones of which the left one shows nothing, though they are within it.

    Where both images show nothing in the same rows, nobody knows, and all pieces stay.
    """
    if not (len(left.piece) and len(right.piece)):
        return right
    number = np.unique(right.piece, return_inverse=True)[1]
    some = np.arange(len(right.piece)) % EVERY == 0
    shown = _shown(left.point_px[::EVERY], right.point_px[some], image_width, reach)
    if shown is None:
        return right
    count = int(number[-1]) + 1
    is_short = np.bincount(number, minlength=count) <= LONGEST_WIDTHS * float(np.median(right.width_px))
    kept = ~is_short[number] | (np.bincount(number[some], shown, count) > 0)[number]
    return Centrelines(right.point_px[kept], right.piece[kept], right.width_px[kept], right.deviation_px[kept])


def _shown(
    left_px: Float64[np.ndarray, "n 2"], right_px: Float64[np.ndarray, "m 2"], image_width: int, reach: Disparities
) -> Bool[np.ndarray, "m"] | None:
    """Which right points the left image shows, or would not show since they lie beyond it; None where it shows none."""
    disparity = left_px[:, None, 0] - right_px[None, :, 0]
    may_be = np.abs(left_px[:, None, 1] - right_px[None, :, 1]) <= ROWS_PX
    may_be &= (disparity > reach.least_px) & (disparity < reach.most_px)
    if not may_be.any():
        return None
    bin_px = reach.about_px / BINS
    heap = np.bincount((disparity[may_be] / bin_px).astype(np.intp))
    usual_px = (float(np.argmax(np.convolve(heap, np.ones(3), mode="same"))) + 0.5) * bin_px
    shown = (may_be & (np.abs(disparity - usual_px) <= reach.about_px)).any(axis=0)
    return shown | (right_px[:, 0] + usual_px + reach.about_px > image_width - 1)
