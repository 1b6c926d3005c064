"""What it does to a piece of centreline that two strands share it.

Strands that cross at a small angle run as one for a while, and one centreline stands for both. Where their middles are
d apart, what is seen is d wider than a thread, and its middle lies d / 2 beside that of either strand: each errs by
half of what the piece is too wide, and least where they cross. Told that, the strands pass each other once and need not
weave about one line.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from agents.reconstruction.refined.alignment import Alignment
from agents.reconstruction.refined.chains import Chain
from agents.reconstruction.refined.continuation import ADDED
from agents.reconstruction.refined.medians import median
from agents.reconstruction.refined.sightings import CORRELATED_PX
from schemas.messages import Centrelines


def with_shared_pieces(left: Chain, right: Centrelines, aligned: Alignment) -> tuple[Chain, Centrelines]:
    """The same course and centreline, with that error in the deviations of pieces that the thread passes twice."""
    passed = _passed_twice(left.piece[left.piece != ADDED])
    matched = _passed_twice(right.piece[aligned.right_index.astype(int)])
    own = _errors_px(left.width_px, left.piece, passed, passes=2)
    other = _errors_px(right.width_px, right.piece, matched, passes=1)
    return (
        replace(left, deviation_px=np.hypot(left.deviation_px, own)),
        replace(right, deviation_px=np.hypot(right.deviation_px, other)),
    )


def _passed_twice(course: Int64[np.ndarray, "m"]) -> Int64[np.ndarray, "k"]:
    """The pieces to which a course, given by the piece of each of its places, comes back."""
    runs = course[np.flatnonzero(np.diff(course, prepend=course[:1] - 1))]
    number, times = np.unique(runs, return_counts=True)
    return number[times > 1]


def _errors_px(
    width_px: Float64[np.ndarray, "n"], piece: Int64[np.ndarray, "n"], shared: Int64[np.ndarray, "k"], passes: int
) -> Float64[np.ndarray, "n"]:
    """What points err besides, on shared pieces alone: each errs alike, so that all of it says what one place does.

    Args:
        passes: how often the points of a shared piece are listed, one for each pixel.
    """
    error = np.zeros(len(piece))
    for number in shared:
        here = piece == number
        alike = np.sqrt(max(1.0, here.sum() / passes / CORRELATED_PX))
        error[here] = 0.5 * alike * np.maximum(width_px[here] - median(width_px), 0.0)
    return error
