"""Whether a part of an image shows what is known of it: the thread that is followed, and no other.

The network looks at the part by itself. The whole is to be looked at where that shows

- thread that lies neither beside the one that is followed nor where something else is known to be;
- nothing along a stretch of a known thread;
- strands that meet or cross where none was cut, or nothing of the kind where one was.

What is known to be in a part while a thread is followed, a glance need not wonder about. All parts of both images have
their turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8
from scipy.spatial import cKDTree

from agents.perception.candidates.drawn import SPACING_PX
from agents.perception.centrelines.along import STRIDE, Pieces
from agents.perception.centrelines.glints import depth_of
from agents.perception.centrelines.skeleton import skeleton_paths
from agents.perception.following.appearance import pieces_of
from agents.perception.segmentation.classes import ThreadScore, score_within
from agents.perception.segmentation.network import FAINTEST, thread_in
from schemas.messages import Centrelines, ThreadObservations, Trail
from shared.images import decode_image

BESIDE_SHARE = 0.01
"""Of the width: so near to a followed thread all thread is its own."""
OTHERS_SHARE = 0.03
"""Of the width: how far threads that are not followed may have moved since they were seen."""
BESIDE_OCCLUDER_CELLS = 2
"""Of the map of occluders, which is coarse."""
GAP = 3.0
"""Times the usual distance of the points of a line that travels: there it is cut."""

Box = tuple[slice, slice]


@dataclass(frozen=True)
class Known:
    """One image's thread, and what else is known to be in a box of it.

    Fields:
        lines: of the thread that is followed.
        cuts_px: where pieces of it are cut, and do not end.
        others_px: points of threads that are not.
        own, elsewhere: whether pixels of the box lie beside the thread that is followed; whether at something else
            that is known.
    """

    lines: Centrelines
    cuts_px: Float64[np.ndarray, "c 2"]
    others_px: Float64[np.ndarray, "o 2"]
    own: Bool[np.ndarray, "h w"]
    elsewhere: Bool[np.ndarray, "h w"]


def known_in(observed: ThreadObservations, eye: int, coverage: UInt8[np.ndarray, "h w"], box: Box) -> Known:
    """What is known of a box in one eye's image.

    Args:
        observed: of a followed thread, with candidates and occluders.
        eye: 0 for the left one, 1 for the right one.
        coverage: by the followed thread, of the whole image.
    """
    lines = (observed.centrelines_left, observed.centrelines_right)[eye]
    trail = (observed.trail_left, observed.trail_right)[eye]
    listed = [(candidate.left_px, candidate.right_px)[eye] for candidate in observed.candidates[1:]]
    others = [line for line in listed if len(line) and not _is_followed(line, coverage)]
    reach = round(BESIDE_SHARE * coverage.shape[1])
    own = cv2.dilate(coverage[box], np.ones((2 * reach + 1,) * 2, np.uint8))
    return Known(
        lines,
        _cuts_px(lines, trail),
        np.concatenate((np.zeros((0, 2)), *others)),
        np.asarray(own) > 0,
        _elsewhere(observed, eye, others, coverage.shape, box),
    )


def _is_followed(line: Float64[np.ndarray, "n 2"], coverage: UInt8[np.ndarray, "h w"]) -> bool:
    """Whether a thread that is not the one that is meant is followed with it."""
    u, v = (np.rint(line[:, k]).astype(np.intp).clip(0, coverage.shape[1 - k] - 1) for k in (0, 1))
    return bool((coverage[v, u] > 0).mean() > 0.5)


def _cuts_px(lines: Centrelines, trail: Trail | None) -> Float64[np.ndarray, "c 2"]:
    if trail is None:
        return np.zeros((0, 2))
    pieces = pieces_of(lines)
    return lines.point_px[np.concatenate((pieces.first[~trail.loose_start], pieces.last[~trail.loose_end]))]


def _elsewhere(
    observed: ThreadObservations,
    eye: int,
    others: Sequence[Float64[np.ndarray, "n 2"]],
    shape: tuple[int, ...],
    box: Box,
) -> Bool[np.ndarray, "h w"]:
    """Where threads that are not followed were, and what may hide thread."""
    rows, columns = box
    about = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.uint8)
    wide, corner = round(2 * OTHERS_SHARE * shape[1]), np.array((columns.start, rows.start))
    for line in others:
        step = np.linalg.norm(np.diff(line, axis=0), axis=1)
        parts = np.split(np.rint(line - corner).astype(np.int32), np.flatnonzero(step > GAP * SPACING_PX) + 1)
        cv2.polylines(about, [part[:, None] for part in parts], False, 255, wide)
    if observed.occluders is not None:
        image = observed.occluders.right if eye else observed.occluders.left
        side = 2 * BESIDE_OCCLUDER_CELLS + 1
        near = cv2.dilate((decode_image(image) > 0).astype(np.uint8), np.ones((side, side), np.uint8))
        occluded = np.asarray(cv2.resize(near, shape[1::-1], interpolation=cv2.INTER_NEAREST))[box]
        return (about > 0) | (occluded > 0)
    return about > 0


PARTS = 8
CONTEXT_PX = 48
"""Around a part that is looked at too."""


@dataclass(frozen=True)
class Part:
    """A quarter of one image.

    Fields:
        eye: 0 for the left one, 1 for the right one.
        row, column: of the quarter, 0 or 1.
    """

    eye: int
    row: int
    column: int

    def inner(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Its rows and columns in an image of that shape."""
        return _half(self.row, shape[0]), _half(self.column, shape[1])

    def outer(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """The same with what is looked at around it."""
        rows, columns = (
            slice(max(0, side.start - CONTEXT_PX), min(size, side.stop + CONTEXT_PX))
            for side, size in zip(self.inner(shape), shape, strict=False)
        )
        return rows, columns


def _half(which: int, size: int) -> slice:
    return slice(size // 2, size) if which else slice(0, size // 2)


def next_part(last: ThreadObservations) -> Part:
    """The part that is glanced at next, the eyes in turn."""
    number = last.glances % PARTS
    return Part(number % 2, number // 4, number // 2 % 2)


LEAST_NEW_PX = 24
"""Of thread that is not known: shorter is a speck."""
SEEN_WITHIN_PX = 4
"""Of a followed point: there is thread where one is."""
LEAST_GONE_SHARE = 0.04
"""Of the width: a stretch as long as that is no chance; a shorter thread would be none of its own."""
OTHERS_GONE = 0.5
"""Of the points of threads that are not followed."""
CUT_WIDTHS = 6.0
"""So far from each other a junction is and where it cuts pieces, which lie on its sides."""


def part_score(image: UInt8[np.ndarray, "h w 3"], part: Part) -> ThreadScore:
    """How much of each pixel of a part, and of what is looked at around it, the network holds to be thread.

    Args:
        image: of that eye, the whole.
    """
    return score_within(image, part.outer(image.shape))


def glance(score: ThreadScore, observed: ThreadObservations, coverage: UInt8[np.ndarray, "h w"], part: Part) -> str:
    """What a part of one eye's image shows that following does not know; empty where there is nothing.

    Args:
        score: of the part.
        observed: of the thread that was followed in the image, with candidates and occluders.
        coverage: by that thread in the whole image.
    """
    inner, outer = part.inner(coverage.shape), part.outer(coverage.shape)
    known = known_in(observed, part.eye, coverage, outer)
    thread = thread_in(score)
    rows, columns = (slice(a.start - b.start, a.stop - b.start) for a, b in zip(inner, outer, strict=True))
    if _longest_extent_px((thread & ~known.own & ~known.elsewhere)[rows, columns]) >= LEAST_NEW_PX:
        return "thread where none is known"
    corner = np.array((outer[1].start, outer[0].start))
    if _is_gone(known, score, inner, corner, coverage.shape[1]):
        return "no thread where one is known"
    return _about_junctions(known, thread, inner, corner)


def _longest_extent_px(mask: Bool[np.ndarray, "h w"]) -> float:
    """Of its connected pieces, in rows and columns together."""
    stats = np.asarray(cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)[2])[1:]
    return float(np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]).max(initial=0.0))


def _is_gone(
    known: Known,
    score: ThreadScore,
    inner: tuple[slice, slice],
    corner: Float64[np.ndarray, "2"],
    width: int,
) -> bool:
    """Whether a stretch of the followed thread, or most of another one, shows nothing of it."""
    high = (score[..., 0] >= FAINTEST).view(np.uint8)
    point, piece = known.lines.point_px, known.lines.piece
    here = np.flatnonzero(_within(point, inner))
    gone = np.flatnonzero(~_is_near(high, point[here] - corner, SEEN_WITHIN_PX))
    stretch = np.cumsum((np.diff(here[gone], prepend=-2) != 1) | (np.diff(piece[here[gone]], prepend=-1) != 0))
    if STRIDE * np.bincount(stretch, minlength=1).max() >= LEAST_GONE_SHARE * width:
        return True
    others = known.others_px[_within(known.others_px, inner)] - corner
    near = _is_near(high, others, round(OTHERS_SHARE * width))
    return bool(len(others) and near.mean() < 1 - OTHERS_GONE)


def _is_near(mask: UInt8[np.ndarray, "h w"], point: Float64[np.ndarray, "n 2"], reach_px: int) -> Bool[np.ndarray, "n"]:
    if not len(point):
        return np.zeros(0, bool)
    about = np.asarray(cv2.dilate(mask, np.ones((2 * reach_px + 1,) * 2, np.uint8)))
    u, v = (np.rint(point[:, k]).astype(np.intp).clip(0, mask.shape[1 - k] - 1) for k in (0, 1))
    return about[v, u] > 0


def _within(point: Float64[np.ndarray, "n 2"], inner: tuple[slice, slice]) -> Bool[np.ndarray, "n"]:
    rows, columns = inner
    u, v = point.T
    return (u >= columns.start) & (u < columns.stop) & (v >= rows.start) & (v < rows.stop)


def _about_junctions(
    known: Known, thread: Bool[np.ndarray, "h w"], inner: tuple[slice, slice], corner: Float64[np.ndarray, "2"]
) -> str:
    """What is said of strands that meet or cross elsewhere than was known."""
    seen = _cuts_in(thread) + corner
    near = CUT_WIDTHS * float(np.median(known.lines.width_px))
    if _any_far(_told(seen, known, inner, corner), known.cuts_px, near):
        return "strands meet where none did"
    if _any_far(_told(known.cuts_px, known, inner, corner), seen, near):
        return "strands meet no longer"
    return ""


def _cuts_in(thread: Bool[np.ndarray, "h w"]) -> Float64[np.ndarray, "n 2"]:
    """Where the skeleton of a mask is cut, since strands meet there."""
    if not thread.any():
        return np.zeros((0, 2))
    paths = skeleton_paths(thread, depth_of(thread))
    pieces = Pieces(paths.path)
    at = np.concatenate((pieces.first[~paths.loose_start], pieces.last[~paths.loose_end]))
    return paths.pixel[at][:, ::-1].astype(np.float64)


def _told(
    point: Float64[np.ndarray, "n 2"], known: Known, inner: tuple[slice, slice], corner: Float64[np.ndarray, "2"]
) -> Float64[np.ndarray, "m 2"]:
    """Those within the part, and not where another thread or an instrument is known to be."""
    mine = point[_within(point, inner)]
    u, v = np.rint(mine - corner).astype(np.intp).T
    return mine[~known.elsewhere[v.clip(0, known.elsewhere.shape[0] - 1), u.clip(0, known.elsewhere.shape[1] - 1)]]


def _any_far(point: Float64[np.ndarray, "n 2"], others: Float64[np.ndarray, "m 2"], far_px: float) -> bool:
    if not len(point):
        return False
    return not len(others) or bool(np.asarray(cKDTree(others).query(point)[0]).max() > far_px)
