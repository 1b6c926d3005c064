"""Where a line of thread ends in a needle: stretches at the ends of lines that look like metal, told thread from none.

A needle is swaged to the end of its thread, so a stretch that looks like metal within a line is thread. One at its end
is thread by what it shows and by how surely the rest of its line is thread.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64

from agents.perception.segmentation.classes import ThreadScore

LIKELY_METAL = 0.5
"""A stretch is asked about where metal is more than so likely as thread is."""
WEIGHTS = 0.4, 0.87, 0.69, -1.36
"""Of what speaks for an end's being thread (`Ends.evidence`), in log-odds; by `benchmarks.training.line_odds`."""
APART_PX = 3
"""How far apart the places may be at which one end of a stretch meets its line."""
_NEXT = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class Ends:
    """Stretches that look like metal, each at one end of a line.

    Fields:
        pixel: indices of their pixels; end: which each belongs to, from 0.
        evidence: of each end its mean log-odds of being thread and not ground, and not metal; the latter of the rest of
            the line; and 1.
    """

    pixel: Int64[np.ndarray, "p"]
    end: Int64[np.ndarray, "p"]
    evidence: Float64[np.ndarray, "e 4"]


def without_needles(
    score: ThreadScore, is_line: Bool[np.ndarray, "h w"], least_log_odds: float
) -> Bool[np.ndarray, "h w"]:
    """The lines without those ends whose odds of being thread are less."""
    ends = ends_of(score, is_line)
    if not len(ends.evidence):
        return is_line
    is_needle = ends.evidence @ WEIGHTS < least_log_odds
    kept = is_line.copy()
    kept.ravel()[ends.pixel[is_needle[ends.end]]] = False
    return kept


def ends_of(score: ThreadScore, is_line: Bool[np.ndarray, "h w"]) -> Ends:
    """The ends of lines that look like metal: stretches that meet the rest of their line in one place."""
    thread, metal = cv2.split(score)
    is_metal = is_line & (metal > cv2.convertScaleAbs(thread, alpha=LIKELY_METAL))
    is_rest = is_line & ~is_metal
    stretches, stretch = _labelled(is_metal)
    rests, rest = _labelled(is_rest)
    # every pixel of the rest that touches a stretch, and which place of contact it belongs to
    beside = np.asarray(cv2.dilate(stretch.astype(np.float32), _NEXT))
    touching = (beside > 0) & is_rest
    _, place = _labelled(cv2.dilate(touching.view(np.uint8), np.ones((2 * APART_PX + 1, 2 * APART_PX + 1), np.uint8)))
    at = np.flatnonzero(touching)
    of_stretch = beside.ravel()[at].astype(np.int64)
    met = np.unique(np.column_stack((of_stretch, place.ravel()[at])), axis=0)
    is_end = np.bincount(met[:, 0], minlength=stretches) == 1
    rest_of = np.zeros(stretches, np.int64)
    rest_of[of_stretch] = rest.ravel()[at]

    pixel = np.flatnonzero(is_metal)
    of = stretch.ravel()[pixel]
    ends = np.flatnonzero(is_end)
    shown = mean_log_odds(score, pixel, of, stretches)[ends]
    rest_pixel = np.flatnonzero(is_rest)
    of_rest = mean_log_odds(score, rest_pixel, rest.ravel()[rest_pixel], rests)[rest_of[ends], 1]
    at_end = is_end[of]
    return Ends(pixel[at_end], np.searchsorted(ends, of[at_end]), np.column_stack((shown, of_rest, np.ones(len(ends)))))


def _labelled(mask: np.ndarray) -> tuple[int, Int32[np.ndarray, "h w"]]:
    count, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    return count, np.asarray(labels, np.int32)


def mean_log_odds(
    score: ThreadScore, pixel: Int64[np.ndarray, "p"], part: Int32[np.ndarray, "p"], count: int
) -> Float64[np.ndarray, "c 2"]:
    """Of each of so many parts of lines, the mean log-odds of being thread and not ground, and not metal."""
    of_thread, of_metal = score.reshape(-1, 2)[pixel].T.astype(np.float64)
    others = np.maximum((255 - of_thread - of_metal, of_metal), 1)
    pixels = np.maximum(np.bincount(part, minlength=count), 1)
    return np.column_stack([np.bincount(part, each, count) / pixels for each in np.log(of_thread / others)])
