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

from agents.perception.candidates.appearance import looks_of, unlikeness
from agents.perception.candidates.both_eyes import BothEyes, in_both_eyes
from agents.perception.candidates.threads import Threads, lengths_px, pieces_of, threads_of
from schemas.messages import Centrelines, ThreadCandidate

LONG_SHARE = 0.3
"""Of the image's width."""
LEAST_SHARE, LEAST_WIDTHS = 0.04, 8.0
"""Of the image's width, and in widths of the thread: what is shorter than either is no thread of its own."""
MOST_LISTED = 6
SPACING_PX = 4
"""Of the points that travel; those of centrelines lie a pixel apart."""
NEAR_SHARE = 0.02
"""Of the image's width: so near to what is meant lies the thread that is meant."""
ANOTHER = 14.0
"""What looks so unlike the thread that is meant (see `unlikeness`) is another one; what does not may go on from it."""
RATHER = 9.0
"""By so much another thread's must a right piece be rather than that of the thread that is meant."""


@dataclass(frozen=True)
class Candidates:
    """The threads that were found, and the centrelines without those of threads that are certainly not meant.

    Fields:
        listed: the one that is meant first, the others by score.
    """

    listed: tuple[ThreadCandidate, ...]
    left: Centrelines
    right: Centrelines


def candidates_in(
    images: tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]],
    lines: tuple[Centrelines, Centrelines],
    meant_px: Float64[np.ndarray, "m 2"] | None = None,
    segmenter_score: UInt8[np.ndarray, "r c"] | None = None,
) -> Candidates:
    """The threads of a rectified pair.

    Args:
        lines: the middle of all that was segmented, left and right.
        meant_px: places of the left image on the thread that is meant, such as where it was in the frame before; of the
            highest score, if it is None or no thread is near.
        segmenter_score: of the left image, or of a smaller copy of it: how much of a pixel is thread, 0 to 255.
    """
    (left, right), width = lines, images[0].shape[1]
    threads, pieces = threads_of(images[0], left), pieces_of(right)
    eyes = in_both_eyes(left, threads, right, pieces, looks_of(images[1], right, pieces), width)
    long = lengths_px(left, threads)
    sure = _sureness(left, threads, segmenter_score, width)
    score = (1.0 - np.exp(-long / (LONG_SHARE * width))) * eyes.share * sure
    listed = np.flatnonzero(long >= np.maximum(LEAST_SHARE * width, LEAST_WIDTHS * threads.looks.width_px))
    if len(listed) == 0:
        return Candidates((), left, right)
    chosen = _meant(left, threads, listed, score, meant_px, width)
    order = sorted(listed.tolist(), key=lambda t: (t != chosen, -score[t]))[:MOST_LISTED]
    found = tuple(_candidate(t, float(score[t]), threads, left, right, pieces, eyes) for t in order)
    if len(listed) == 1:
        return Candidates(found, left, right)
    others = _others(threads, listed, chosen)
    return Candidates(
        found, _without(left, _of_threads(threads, others)), _without(right, _rather(eyes, pieces, chosen, others))
    )


def _sureness(
    left: Centrelines, threads: Threads, score: UInt8[np.ndarray, "r c"] | None, width: int
) -> Float64[np.ndarray, "t"]:
    """The mean of the segmenter's score along each thread, 0 to 1; 1 where there is none."""
    if score is None:
        return np.ones(len(threads.points))
    # a small copy spreads a thread's score over its neighbours, so the greatest nearby counts
    near = cv2.dilate(score, np.ones((3, 3), np.uint8)) if score.shape[1] < width else score
    at = np.rint((left.point_px + 0.5) * (score.shape[1] / width) - 0.5).astype(np.intp)
    along = near[at[:, 1].clip(0, near.shape[0] - 1), at[:, 0].clip(0, near.shape[1] - 1)] / 255.0
    return np.array([along[points].mean() for points in threads.points])


def _meant(
    left: Centrelines,
    threads: Threads,
    listed: Int64[np.ndarray, "l"],
    score: Float64[np.ndarray, "t"],
    meant_px: Float64[np.ndarray, "m 2"] | None,
    width: int,
) -> int:
    """The thread that is meant: the one that lies nearest to most of the places that are."""
    best = int(listed[np.argmax(score[listed])])
    if meant_px is None or len(meant_px) == 0:
        return best
    away = np.array([cKDTree(left.point_px[threads.points[t]]).query(meant_px)[0] for t in listed])
    nearest, near = np.argmin(away, axis=0), away.min(axis=0) <= NEAR_SHARE * width
    votes = np.bincount(nearest[near], minlength=len(listed))
    return int(listed[np.argmax(votes)]) if votes.any() else best


def _others(threads: Threads, listed: Int64[np.ndarray, "l"], chosen: int) -> list[int]:
    """Which of the listed threads are certainly not the chosen one: they look different."""
    unlike = unlikeness(threads.looks, threads.looks)[chosen]
    return [int(t) for t in listed if t != chosen and unlike[t] >= ANOTHER]


def _of_threads(threads: Threads, which: list[int]) -> Int64[np.ndarray, "n"]:
    return np.concatenate([np.zeros(0, np.int64), *(threads.points[t] for t in which)])


def _rather(
    eyes: BothEyes, pieces: list[Int64[np.ndarray, "k"]], chosen: int, others: list[int]
) -> Int64[np.ndarray, "n"]:
    """The right image's points that are rather another thread's than the chosen one's."""
    rather = np.isin(eyes.thread, others) & (eyes.against[chosen] - eyes.against.min(axis=0) >= RATHER)
    return np.concatenate([np.zeros(0, np.int64), *(pieces[p] for p in np.flatnonzero(rather))])


def _without(lines: Centrelines, points: Int64[np.ndarray, "k"]) -> Centrelines:
    """The centrelines without these points, which are whole pieces."""
    kept = np.ones(len(lines.piece), bool)
    kept[points] = False
    number = np.cumsum(np.diff(lines.piece[kept], prepend=-1) > 0) - 1
    return Centrelines(lines.point_px[kept], number, lines.width_px[kept], lines.deviation_px[kept])


def _candidate(
    thread: int,
    score: float,
    threads: Threads,
    left: Centrelines,
    right: Centrelines,
    pieces: list[Int64[np.ndarray, "k"]],
    eyes: BothEyes,
) -> ThreadCandidate:
    points = left.point_px[threads.points[thread]]
    mine = [right.point_px[pieces[p]] for p in np.flatnonzero(eyes.thread == thread)]
    lab = np.rint(threads.looks.lab[thread]).clip(0, 255).astype(np.uint8)
    return ThreadCandidate(
        score=min(1.0, score),
        left_px=_thinned(points),
        right_px=_along(points, [_thinned(piece) for piece in mine]),
        width_px=float(threads.looks.width_px[thread]),
        colour_bgr=cv2.cvtColor(lab[None, None], cv2.COLOR_Lab2BGR)[0, 0].astype(np.int64),
    )


def _thinned(points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "k 2"]:
    """Fewer of them, both ends included."""
    return points[np.unique(np.append(np.arange(0, len(points), SPACING_PX), len(points) - 1))]


def _along(points: Float64[np.ndarray, "n 2"], pieces: list[Float64[np.ndarray, "k 2"]]) -> Float64[np.ndarray, "m 2"]:
    """Pieces of the right image in order along the thread of the left one, by the rows that both share."""
    if not pieces:
        return np.zeros((0, 2))
    shift = np.array([np.median(points[:, 0]) - np.median(np.concatenate(pieces)[:, 0]), 0.0])
    tree = cKDTree(points)
    places = [np.asarray(tree.query(piece + shift)[1]) for piece in pieces]
    turned = [piece if at[-1] >= at[0] else piece[::-1] for piece, at in zip(pieces, places, strict=True)]
    return np.concatenate([turned[k] for k in np.argsort([np.median(at) for at in places], kind="stable")])
