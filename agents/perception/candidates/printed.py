"""The middle of what was segmented without lines that lie in the ground: print, ink and stains look like thread."""

import numpy as np
from jaxtyping import Int64, UInt8

from agents.perception.candidates.appearance import looks_of
from agents.perception.candidates.both_eyes import in_both_eyes
from agents.perception.candidates.drawn import without
from agents.perception.candidates.relief import CERTAIN, relief_of
from agents.perception.candidates.sureness import sureness
from agents.perception.candidates.threads import lengths_px, pieces_of, threads_of
from schemas.messages import Centrelines, no_centrelines
from shared.disparities import Disparities, disparities

MOST_ASKED = 6
"""The longest ones; each takes some 15 ms."""

SURE, RATHER = 0.9, 1.25
"""Of a thread's score: where the segmenter is less sure of a line, so many deviations of its relief are enough. Print
that passes for thread scores 0.6 to 0.9, and threads that hardly stand off the ground 0.95 and more."""

Image = UInt8[np.ndarray, "h w 3"]


def without_printed(
    images: tuple[Image, Image],
    lines: tuple[Centrelines, Centrelines],
    least_length_px: float,
    focal_px: float,
    score: UInt8[np.ndarray, "r c"] | None = None,
    reach: Disparities | None = None,
) -> tuple[Centrelines, Centrelines]:
    """The lines of both rectified images without those that certainly lie in the ground.

    Args:
        lines: the middle of all that was segmented, left and right.
        least_length_px: shorter threads are not asked, and go where all longer ones do.
        focal_px: of the rectified camera.
        score: of the left image by the segmenter, where it gives one.
        reach: disparities of thread; by the width alone, if it is None.
    """
    left, right = lines
    threads, pieces = threads_of(images[0], left), pieces_of(right)
    reach = reach or disparities(images[0].shape[1])
    eyes = in_both_eyes(left, threads, right, pieces, looks_of(images[1], right, pieces), reach)
    sure = sureness(left, threads, score, images[0].shape[1])
    long = np.flatnonzero(lengths_px(left, threads) >= least_length_px)
    printed: list[int] = []
    for thread in long[:MOST_ASKED].tolist():
        of_right = [pieces[p] for p in np.flatnonzero(eyes.thread == thread)]
        line = _of(left, threads.points[thread]), _of(right, np.concatenate((np.zeros(0, np.int64), *of_right)))
        if relief_of(images, lines, line, focal_px, CERTAIN if sure[thread] >= SURE else RATHER).is_none:
            printed.append(thread)
    if not printed:
        return lines
    if len(printed) == len(long):
        return no_centrelines(), no_centrelines()
    of_printed = [pieces[p] for p in np.flatnonzero(np.isin(eyes.thread, printed))]
    return without(left, [threads.points[t] for t in printed]), without(right, of_printed)


def _of(lines: Centrelines, points: Int64[np.ndarray, "k"]) -> Centrelines:
    some = np.sort(points)
    return Centrelines(lines.point_px[some], lines.piece[some], lines.width_px[some], lines.deviation_px[some])
