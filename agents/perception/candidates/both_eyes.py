"""Which pieces of the right image belong to which thread of the left one.

The same row of both images holds the same places of a thread, moved left by the disparity. All thread lies at about one
depth, so the disparities between alike points of the same rows heap up about one value; chance spreads its own evenly.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.perception.candidates.links import Looks, unlikeness
from agents.perception.candidates.threads import Threads, pieces_of
from schemas.messages import Centrelines
from shared.disparities import Disparities

EVERY = 6
"""Of the points, which lie a pixel apart, so many as are looked at."""
UNALIKE = 16.0
"""Pieces that look so different (see `unlikeness`) belong to no one thread, were they in the right place."""
ELSEWHERE = 12.0
"""How much it speaks against a piece that no row of it holds any of the thread, in the same measure."""
LEAST_IN_ROWS = 0.3


@dataclass(frozen=True)
class BothEyes:
    """What the right image shows of the threads of the left one.

    Fields:
        thread: of each right piece, the left thread that it belongs to; −1 where none.
        against: how much speaks against each thread (rows) for each right piece (columns).
        share: of each thread's points, those which the right image shows.
    """

    thread: Int64[np.ndarray, "p"]
    against: Float64[np.ndarray, "t p"]
    share: Float64[np.ndarray, "t"]


def in_both_eyes(
    left: Centrelines,
    threads: Threads,
    right: Centrelines,
    pieces: list[Int64[np.ndarray, "k"]],
    looks: Looks,
    reach: Disparities,
) -> BothEyes:
    """The left thread that each right piece belongs to.

    Args:
        pieces, looks: of the right image.
    """
    count = len(threads.points), len(pieces)
    if 0 in count:
        return BothEyes(np.full(count[1], -1), np.zeros(count), np.zeros(count[0]))
    unlike = unlikeness(threads.looks, looks)
    left_at, thread = sampled(threads.points)
    right_at, piece = sampled(pieces)
    same, _ = same_place(left.point_px[left_at], right.point_px[right_at], unlike[thread][:, piece] < UNALIKE, reach)
    of_thread = np.logical_or.reduceat(same, np.flatnonzero(np.diff(thread, prepend=-1)), axis=0)
    in_rows = np.array([np.bincount(piece, row, count[1]) for row in of_thread]) / np.bincount(piece)
    against = unlike + ELSEWHERE * (1.0 - in_rows)
    best = np.argmin(against, axis=0)
    here = np.arange(count[1])
    found = (in_rows[best, here] >= LEAST_IN_ROWS) & (unlike[best, here] < UNALIKE)
    mine = np.where(found, best, -1)
    shown = (same & (mine[piece][None] == thread[:, None])).any(axis=1)
    return BothEyes(mine, against, np.bincount(thread, shown, count[0]) / np.bincount(thread))


def sampled(parts: list[Int64[np.ndarray, "k"]]) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
    """Some indices of each part, and the part's number."""
    some = [part[min(len(part) // 2, EVERY // 2) :: EVERY] for part in parts]
    return np.concatenate(some), np.repeat(np.arange(len(some)), [len(part) for part in some])


def same_place(
    left_px: Float64[np.ndarray, "n 2"],
    right_px: Float64[np.ndarray, "m 2"],
    alike: Bool[np.ndarray, "n m"],
    reach: Disparities,
) -> tuple[Bool[np.ndarray, "n m"], float]:
    """Which points may be one place: in one row, and about as far from each other as most such points are: how far.

    Args:
        alike: which look alike.
    """
    disparity = left_px[:, None, 0] - right_px[None, :, 0]
    same_row = np.abs(left_px[:, None, 1] - right_px[None, :, 1]) <= 0.5 * EVERY + 0.5
    may_be = same_row & alike & (disparity > reach.least_px) & (disparity < reach.most_px)
    if not may_be.any():
        return may_be, 0.0
    bin_px = 0.25 * reach.about_px
    heap = np.bincount((disparity[may_be] / bin_px).astype(np.intp))
    usual = (float(np.argmax(np.convolve(heap, np.ones(5), mode="same"))) + 0.5) * bin_px
    return may_be & (np.abs(disparity - usual) <= reach.about_px), usual


def length_in_common_px(lines: tuple[Centrelines, Centrelines], reach: Disparities) -> float:
    """The length of what both eyes show of the lines of a rectified pair, in the eye that shows less of it."""
    left, right = lines
    of_left, of_right = pieces_of(left), pieces_of(right)
    if not (of_left and of_right):
        return 0.0
    left_px, right_px = left.point_px[sampled(of_left)[0]], right.point_px[sampled(of_right)[0]]
    same, _ = same_place(left_px, right_px, np.ones((len(left_px), len(right_px)), bool), reach)
    return float(EVERY * min(np.count_nonzero(same.any(axis=axis)) for axis in (0, 1)))
