"""Thread on textured ground without weights: elongated ridges, then the colour of the most thread-like of them.

Found on a reduced image, where a thread is one to four pixels wide; its width comes from the full one at the end.

1. What is darker than its surroundings and what is brighter are looked at apart, so that the gap between two glints
   is no dark line. A glint is many times brighter than any thread, and counts no more for that.
2. Oriented filters (`line_filter`) answer to lines of the thread's width and hardly to specks. Strong ridges are
   seeds, weaker ones connected to them extend them.
3. What lies on instruments, or close to them, only extends what lies apart (`instrument_edges`).
4. Of the connected ridges the one whose colour is rarest in the image, weighted by its contrast, is taken to be
   thread. Its colour decides which other ridges belong to it: vessels and folds are ridges too, of another colour.
   A pixel that is only partly thread has a mixture of the thread's colour and the ground's, and is judged as one.
5. The thread's colour and the ground's tell the contrast that it should have there. What has far less of it is a fold
   of the ground, and along the border of an instrument what has a little less is that.

Where it is known about where the thread is, only what lies near is looked at: the same numbers come out there, as if
nothing else in the image were a ridge. Where it is said which thread is meant, instruments are none of it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from agents.perception.segmentation.connected import of_pixels
from agents.perception.segmentation.near import Meant, Near
from benchmarks.ridge.candidate import (
    GLINT,
    GROW_SHARE,
    SEED_SHARE,
    Candidate,
    candidate_of,
    meant_score,
    polarities,
)
from benchmarks.ridge.colour import (
    COLOUR_LIMIT,
    deviations_from_thread,
    expected_contrast,
    lab_of,
    medians,
)
from benchmarks.ridge.full_size import at_full_size
from benchmarks.ridge.instrument_edges import along_borders
from benchmarks.ridge.pieces import connected_pieces, going_on, weight_meant
from benchmarks.ridge.view import View, in_whole, view_of

LEAST_WEIGHT_SHARE, LEAST_EXTENT_SHARE = 0.06, 0.2
"""Pieces with less response, or less extent, than this share of the greatest are clutter."""
LEAST_THREAD_PX, LEAST_SHARE_OF_LENGTH, LEAST_RESPONSE = 48, 0.2, 6.0
"""What cannot be thread alone: pieces of which the longest is shorter, or has less of the length of all together, as in
a field of glints; and ridges of fewer grey levels in the median, as in folds and noise."""
GROWN_COLOUR_LIMIT = 4.5
"""Deviations from the thread's colour up to which a pixel extends a piece of thread."""
BEST_PERCENT = 25
"""Of a piece, by its score: what is thread and nothing else."""
LEAST_OF_EXPECTED = 0.24
"""Of how a pixel of the thread's best part responds for its contrast: one that responds less is none of it."""
EDGE_OF_EXPECTED, EDGE_COLOUR_LIMIT = 0.6, 2.0
"""The same, and deviations of colour, for what runs along the border of an instrument."""
RIVAL_SHARE = 0.4
"""Dark thread, or bright thread, that weighs less than this share of the other is not looked at further."""


@dataclass(frozen=True)
class _Found:
    """Ridge pixels of one polarity that look like thread.

    Fields:
        alike: of all its ridge pixels, which look so by themselves; seeds: those that are certain.
    """

    pixel: Int64[np.ndarray, "p"]
    alike: Bool[np.ndarray, "q"]
    seeds: Bool[np.ndarray, "q"]


NOTHING = _Found(np.zeros(0, np.int64), np.zeros(0, bool), np.zeros(0, bool))


def segment_ridge(
    image: UInt8[np.ndarray, "h w 3"], near: Near | None = None, meant: Meant | None = None
) -> UInt8[np.ndarray, "h w"]:
    """Coverage of each pixel by thread, 0 or 255: dark or bright thread, whichever stands out more.

    Args:
        near: where thread is looked for; anywhere, if it is None.
        meant: which ridge is thread; the one that stands out most, if it is None.
    """
    where = None if near is None else near.where
    if where is not None and not where.any():
        return np.zeros(image.shape[:2], np.uint8)
    view = view_of(image, near, meant)
    likely, unlikely = polarities(view, near)
    chosen, found = _most_conspicuous([candidate_of(view, is_bright) for is_bright in likely], view)
    if unlikely and not len(found.pixel):
        chosen, found = _most_conspicuous([candidate_of(view, is_bright) for is_bright in unlikely], view)
    ridge = of_pixels(found.pixel, view.seen.shape[:2])
    background, ridge, contrast = (in_whole(part, view) for part in (view.background, ridge, chosen.contrast))
    return at_full_size(image, background, ridge, contrast, chosen.is_bright)


def _most_conspicuous(candidates: list[Candidate], view: View) -> tuple[Candidate, _Found]:
    """The candidate that is thread, and what of it: the second one is asked only where it may be that."""
    first, *others = sorted(candidates, key=lambda candidate: -candidate.weight)
    found = _thread_among(first, view)
    for other in others:
        if other.weight >= RIVAL_SHARE * first.weight or not len(found.pixel):
            rival = _thread_among(other, view)
            if _strength(other, rival, view) > _strength(first, found, view):
                return other, rival
    return first, found


def _strength(candidate: Candidate, found: _Found, view: View) -> float:
    """What speaks for what was found, against what was found of the other polarity."""
    ridges, alike = candidate.ridges, found.alike
    if not len(alike):
        return 0.0
    if view.meant is not None:
        pieces = connected_pieces(ridges, alike, found.seeds)
        return float(weight_meant(pieces, meant_score(ridges, view.meant)).max())
    # faint pixels would count for whichever polarity has more clutter to grow into
    clear = alike & (ridges.response > GROW_SHARE * candidate.strong)
    return float(connected_pieces(ridges, clear, found.seeds).weight.max())


def _thread_among(candidate: Candidate, view: View) -> _Found:
    """The thread among the ridges of one polarity, by how its most conspicuous piece looks."""
    if candidate.weight <= 0:
        return NOTHING
    ridges, response, strong = candidate.ridges, candidate.ridges.response, candidate.strong
    away, of_expected = _unlike(candidate, view)
    alike = (away < GROWN_COLOUR_LIMIT) & (of_expected > LEAST_OF_EXPECTED)
    if view.instruments is not None:
        doubtful = np.flatnonzero(alike & ~((away < EDGE_COLOUR_LIMIT) & (of_expected > EDGE_OF_EXPECTED)))
        alike[doubtful[along_borders(view.instruments, candidate.line, ridges.pixel[doubtful])]] = False
    seeds = alike & ridges.apart & (away < COLOUR_LIMIT) & (response > SEED_SHARE * strong)
    pieces = connected_pieces(ridges, alike, seeds)
    longest = pieces.extent[pieces.weight > 0].max(initial=0)
    kept = (pieces.weight > LEAST_WEIGHT_SHARE * pieces.weight.max()) & (pieces.extent > LEAST_EXTENT_SHARE * longest)
    kept |= going_on(ridges, pieces, kept, away, of_expected)
    if view.meant is not None:
        counting = weight_meant(pieces, meant_score(ridges, view.meant))
        chosen = kept & (counting == counting.max()) & (counting > 0)
        return _Found(ridges.pixel[(chosen if view.meant.alone else kept)[pieces.of]], alike, seeds)
    if not _may_be_thread(pieces.extent, kept, longest, response[kept[pieces.of]]):
        return NOTHING
    return _Found(ridges.pixel[kept[pieces.of]], alike, seeds)


def _may_be_thread(
    extent: Float64[np.ndarray, "c"], kept: Bool[np.ndarray, "c"], longest: float, response: Float32[np.ndarray, "q"]
) -> bool:
    """Whether the pieces that are kept are long enough, and few and clear enough, for any of them to be thread."""
    if longest < max(LEAST_THREAD_PX, LEAST_SHARE_OF_LENGTH * extent[kept].sum()):
        return False
    return bool(medians(response[None])[0, 0] >= LEAST_RESPONSE)


def _unlike(candidate: Candidate, view: View) -> tuple[Float32[np.ndarray, "p"], Float32[np.ndarray, "p"]]:
    """How far each ridge pixel's colour is from thread, in deviations; how it responds, as a share of what is expected.

    What is expected is what the best part of the most conspicuous piece does, for the contrast that thread has there.
    """
    ridges, piece = candidate.ridges, candidate.piece
    of_piece = ridges.score[piece]
    least = (len(of_piece) - 1) * (100 - BEST_PERCENT) // 100
    best = piece & (ridges.score >= np.partition(of_piece, least)[least])
    ground = view.background.reshape(-1, 3)[ridges.pixel]
    away = deviations_from_thread(ridges.colour, lab_of(ground), best, piece)
    thread = medians(view.seen.reshape(-1, 3)[ridges.pixel[best]].T.astype(np.float32))[:, 0]
    most = GLINT if candidate.is_bright else np.inf
    responds = ridges.response / expected_contrast(thread, ground, candidate.is_bright, most)
    return away, responds / medians(responds[None, best])[0]
