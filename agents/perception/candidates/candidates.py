"""The threads that a pair shows, each with a score, and the one of them that is meant.

The score is the product of three shares, and no probability:

- how much is seen: 1 − exp(−length / 30 % of the image's width);
- how much of it both eyes see;
- how sure the segmenter is: the mean of its score along the middle, where it gives one.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8
from scipy.spatial import cKDTree

from agents.perception.candidates.both_eyes import ELSEWHERE, in_both_eyes
from agents.perception.candidates.drawn import Piece, along, only, thinned, without
from agents.perception.candidates.links import looks_of
from agents.perception.candidates.others import ANOTHER, alike, certainly_others
from agents.perception.candidates.threads import Threads, lengths_px, pieces_of, threads_of
from schemas.messages import Centrelines, ThreadCandidate
from shared.disparities import Disparities, disparities


def sureness(
    left: Centrelines, threads: Threads, score: UInt8[np.ndarray, "r c"] | None, width: int
) -> Float64[np.ndarray, "t"]:
    """The mean of the segmenter's score along each thread, 0 to 1; 1 where there is none."""
    if score is None:
        return np.ones(len(threads.points))
    at = np.rint((left.point_px + 0.5) * (score.shape[1] / width) - 0.5).astype(np.intp)
    sure = score[at[:, 1].clip(0, score.shape[0] - 1), at[:, 0].clip(0, score.shape[1] - 1)] / 255.0
    return np.array([sure[points].mean() for points in threads.points])


LONG_SHARE = 0.3
"""Of the image's width."""
LEAST_SHARE, LEAST_WIDTHS = 0.04, 8.0
"""Of the image's width, and in widths of the thread: what is shorter than either is no thread of its own."""
MOST_LISTED = 6
NEAR_SHARE = 0.03
"""Of the image's width: so near to what is meant lies the thread that is meant."""
RATHER = 9.0
"""By so much another thread's must a right piece be rather than that of the thread that is meant."""
NOBODYS = ELSEWHERE + ANOTHER
"""So much against every thread: a right piece that looks like none of them, in rows that hold none."""


@dataclass(frozen=True)
class Candidates:
    """The threads that were found, and the centrelines without those of threads that are certainly not meant.

    Fields:
        listed: the one that is meant first, the others by score.
        strands: the centrelines of those that look like it, left and right, which are left out of these.
    """

    listed: tuple[ThreadCandidate, ...]
    left: Centrelines
    right: Centrelines
    strands: tuple[tuple[Centrelines, Centrelines], ...] = ()


def candidates_in(
    images: tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]],
    lines: tuple[Centrelines, Centrelines],
    meant_px: Float64[np.ndarray, "m 2"] | None = None,
    segmenter_score: UInt8[np.ndarray, "r c"] | None = None,
    occluders: UInt8[np.ndarray, "j k"] | None = None,
    reach: Disparities | None = None,
) -> Candidates:
    """The threads of a rectified pair.

    Args:
        lines: the middle of all that was segmented, left and right.
        meant_px: places of the left image on the thread that is meant, such as where it was in the frame before; of the
            highest score, if it is None or no thread is near.
        segmenter_score: of the left image, or of a smaller copy of it: how much of a pixel is thread, 0 to 255.
        occluders: not 0 where something may hide thread, in a copy of the left image; None where nobody knows.
        reach: disparities of thread; by the width alone, if it is None.
    """
    (left, right), width = lines, images[0].shape[1]
    threads, pieces = threads_of(images[0], left), pieces_of(right)
    eyes = in_both_eyes(left, threads, right, pieces, looks_of(images[1], right, pieces), reach or disparities(width))
    long = lengths_px(left, threads)
    score = (1.0 - np.exp(-long / (LONG_SHARE * width))) * eyes.share * sureness(left, threads, segmenter_score, width)
    may_be = np.flatnonzero(long >= np.maximum(LEAST_SHARE * width, LEAST_WIDTHS * threads.looks.width_px))
    if len(may_be) == 0:
        return Candidates((), left, right)
    chosen = _meant(left, threads, may_be, score, meant_px, width)
    order = sorted(may_be.tolist(), key=lambda t: (t != chosen, -score[t]))[:MOST_LISTED]
    of_right = [[pieces[p] for p in np.flatnonzero(eyes.thread == t)] for t in order]
    listed = tuple(
        _candidate(
            left, threads, t, float(score[t]), along(left.point_px[threads.points[t]], right, mine, shifted=True)
        )
        for t, mine in zip(order, of_right, strict=True)
    )
    apart = certainly_others(listed, occluders, width)
    others = [order[k] for k in apart]
    least = eyes.against.min(axis=0, initial=np.inf)
    rather = np.isin(eyes.thread, others) & (eyes.against[chosen] - least >= RATHER)
    of_left = [[threads.points[t]] for t in order]
    return Candidates(
        listed,
        without(left, [threads.points[t] for t in others]),
        without(right, [pieces[p] for p in np.flatnonzero(rather | (least >= NOBODYS))]),
        strands_among(listed, apart, (left, right), (of_left, of_right)),
    )


def strands_among(
    listed: tuple[ThreadCandidate, ...],
    apart: list[int],
    lines: tuple[Centrelines, Centrelines],
    pieces: tuple[list[list[Piece]], list[list[Piece]]],
) -> tuple[tuple[Centrelines, Centrelines], ...]:
    """The lines of each candidate that is left out of those of the first one and looks like it.

    Args:
        apart: the numbers of those that are left out.
        pieces: of either image's lines, those of each candidate.
    """
    if not apart:
        return ()
    is_alike = alike(listed)
    left, right = pieces
    return tuple(
        (only(lines[0], left[k]), only(lines[1], right[k])) for k in apart if is_alike[k] and left[k] and right[k]
    )


def _meant(
    left: Centrelines,
    threads: Threads,
    may_be: Int64[np.ndarray, "l"],
    score: Float64[np.ndarray, "t"],
    meant_px: Float64[np.ndarray, "m 2"] | None,
    width: int,
) -> int:
    """The thread that is meant: the one that lies nearest to most of the places that are."""
    best = int(may_be[np.argmax(score[may_be])])
    if meant_px is None or len(meant_px) == 0:
        return best
    away = np.array([cKDTree(left.point_px[threads.points[t]]).query(meant_px)[0] for t in may_be])
    near = away.min(axis=0) <= NEAR_SHARE * width
    votes = np.bincount(np.argmin(away, axis=0)[near], minlength=len(may_be))
    return int(may_be[np.argmax(votes)]) if votes.any() else best


def _candidate(
    left: Centrelines, threads: Threads, thread: int, score: float, right_px: Float64[np.ndarray, "m 2"]
) -> ThreadCandidate:
    lab = np.rint(threads.looks.lab[thread]).clip(0, 255).astype(np.uint8)
    return ThreadCandidate(
        score=min(1.0, score),
        left_px=thinned(left.point_px[threads.points[thread]]),
        right_px=right_px,
        width_px=float(threads.looks.width_px[thread]),
        colour_bgr=cv2.cvtColor(lab[None, None], cv2.COLOR_Lab2BGR)[0, 0].astype(np.int64),
    )
