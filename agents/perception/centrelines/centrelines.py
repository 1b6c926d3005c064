"""Sub-pixel centrelines: skeleton, then three rounds of correction across the normal, and the ends after the first.

Anti-aliased coverage is corrected by its centroid, which hardly depends on where a strip lies on the pixel grid. A mask
that only says yes or no has lost what is finer than a pixel, so there the edges in the image tell, and after them what
has been learned of how light misleads them.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from agents.perception.centrelines.along import Pieces, directions, evenly_spaced, gaussian, local_quadratic, smoothed
from agents.perception.centrelines.deviation import deviations, of_coverage, of_edges
from agents.perception.centrelines.glints import mean_depth, without_glints
from agents.perception.centrelines.profiles import sample
from agents.perception.centrelines.refine import Curves, Evidence, by_coverage, by_edges, by_learning, tangent_sigma
from agents.perception.centrelines.skeleton import Paths, skeleton_paths
from agents.perception.centrelines.tips import to_tips
from schemas.messages import Centrelines, no_centrelines

SEGMENTED_COVERAGE = 96
"""Coverage from which a pixel counts as thread. Below one half, so that a thread that is thinner than a pixel and
falls between two still counts."""
GROUND_PX = 12
"""Around the thread that is looked at."""
SPACING_PX = 1.0
WIDEST_PX = 40.0
"""Profiles reach no further for a thread wider than this."""
LEAST_GRADED_SHARE = 0.1
"""Of the pixels beside the mask; of anti-aliased coverage most are partly thread, of a binary mask none."""
HALF = 127.5
AROUND = np.ones((3, 3), np.uint8)
LEAST_LENGTH = 1.5
"""Pieces shorter than so many widths are no line."""


@dataclass(frozen=True)
class Followed:
    """Curves along the thread, with what the last round saw, the width in general, and whether coverage was graded."""

    curves: Curves
    seen: Evidence
    width: float
    graded: bool


@dataclass(frozen=True)
class Lines:
    """Centrelines, and of each piece whether it begins and ends at an end of the thread; else it is cut there."""

    centrelines: Centrelines
    loose_start: Bool[np.ndarray, "k"]
    loose_end: Bool[np.ndarray, "k"]


NO_LINES = Lines(no_centrelines(), np.zeros(0, bool), np.zeros(0, bool))


def thread_centrelines(image: UInt8[np.ndarray, "h w 3"], coverage: UInt8[np.ndarray, "h w"]) -> Centrelines:
    """The middle of the thread in one rectified image, as `thread_lines` has it."""
    return thread_lines(image, coverage).centrelines


def thread_lines(image: UInt8[np.ndarray, "h w 3"], coverage: UInt8[np.ndarray, "h w"]) -> Lines:
    """The middle of the thread in one rectified image, and what its pieces end at.

    Args:
        image: BGR.
        coverage: by thread, 0 to 255; anti-aliased, or binary.
    """
    mask = coverage >= SEGMENTED_COVERAGE
    left, top, columns, rows = cv2.boundingRect(mask.view(np.uint8))
    if rows == 0:
        return NO_LINES
    corner = np.array([max(left - GROUND_PX, 0), max(top - GROUND_PX, 0)])
    box = np.s_[corner[1] : top + rows + GROUND_PX, corner[0] : left + columns + GROUND_PX]
    found = _lines(image[box], np.ascontiguousarray(coverage[box], np.float32), mask[box])
    lines = found.centrelines
    inside = np.clip(lines.point_px + corner, 0.0, np.array(coverage.shape[::-1]) - 1.0)
    return replace(found, centrelines=replace(lines, point_px=inside))


def _lines(
    image: UInt8[np.ndarray, "h w 3"], coverage: Float32[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]
) -> Lines:
    found = followed(image, coverage, mask)
    if found is None:
        return NO_LINES
    curves, seen = found.curves, found.seen
    if found.graded:
        at_sight = of_coverage(curves, seen)
    elif (learned := by_learning(curves, seen, image, found.width)) is None:
        at_sight = of_edges(curves, seen)
    else:
        curves, seen, at_sight = learned
    lines = Centrelines(curves.point, curves.pieces.number, seen.width_px, deviations(curves, seen, at_sight))
    if not found.graded:
        # where a mask that says yes or no ends, only the image tells within a pixel
        lines = to_tips(lines, image, curves.loose_start, curves.loose_end)
    return Lines(lines, curves.loose_start, curves.loose_end)


def followed(
    image: UInt8[np.ndarray, "h w 3"], coverage: Float32[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]
) -> Followed | None:
    """Curves along the thread as coverage and edges have it, without what is learned; None where there is none."""
    filled, depth = without_glints(mask)
    # a glint is thread, in what it covers and in its colour
    if filled is not mask:
        coverage = np.where(filled & ~mask, np.float32(255), coverage)
    # never less than the thread's, and up to two pixels more
    width = min(WIDEST_PX, max(1.0, 4.0 * mean_depth(depth, filled)))
    curves = _initial(skeleton_paths(filled, depth), width)
    if len(curves.point) == 0:
        return None
    curves, _ = by_coverage(curves, coverage, width)
    curves = _extended(curves, coverage, width)
    curves, seen = by_coverage(curves, coverage, width)
    graded = _is_graded(coverage, filled)
    curves, seen = by_coverage(curves, coverage, width) if graded else by_edges(curves, seen, image, width)
    return Followed(curves, seen, width, graded)


def _is_graded(coverage: Float32[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]) -> bool:
    """Whether the coverage fades at the mask's border, as anti-aliased coverage does; if not, it has no sub-pixels."""
    thread = mask.view(np.uint8)
    # mostly there is no such pixel anywhere
    if cv2.countNonZero(coverage) == cv2.countNonZero(thread):
        return False
    beside = cv2.subtract(cv2.dilate(thread, AROUND), thread)
    faint = cv2.bitwise_and(beside, (coverage > 0).view(np.uint8))
    return cv2.countNonZero(faint) > LEAST_GRADED_SHARE * cv2.countNonZero(beside)


def _initial(paths: Paths, width: float) -> Curves:
    """Smoothed paths, evenly spaced, without what is too short and without the last half width before loose ends."""
    path = Pieces(paths.path)
    length = path.last - path.first + 1
    # the skeleton turns into a corner of a blunt end
    back = np.where(length > 3 * width, round(0.5 * width), 0)
    loose_ends = paths.loose_start.astype(np.int64) + paths.loose_end
    long_enough = length >= np.maximum(2, (LEAST_LENGTH - 0.5 * loose_ends) * width)
    keep = long_enough[path.number]
    keep &= (path.before >= (back * paths.loose_start)[path.number]) & (
        path.after >= (back * paths.loose_end)[path.number]
    )
    point = paths.pixel[keep][:, ::-1].astype(np.float64)
    pieces = Pieces(np.cumsum(np.diff(path.number[keep], prepend=-1) > 0) - 1)
    if len(point):
        smooth = smoothed(point, pieces, local_quadratic(tangent_sigma(width)))
        point, pieces = evenly_spaced(smooth, pieces, SPACING_PX)
    return Curves(point, pieces, paths.loose_start[long_enough], paths.loose_end[long_enough])


def _extended(curves: Curves, coverage: Float32[np.ndarray, "h w"], width: float) -> Curves:
    """Curves continued straight to where the coverage ends, at loose ends."""
    pieces, point = curves.pieces, curves.point
    tangent = directions(point, pieces, gaussian(tangent_sigma(width)))
    first, last = pieces.first, pieces.last
    ends, outward = np.concatenate((first, last)), np.concatenate((-tangent[first], tangent[last]))
    reach = _reach(coverage, point[ends], outward, np.arange(0.0, 2 * width + 4, 0.25))
    reach[~np.concatenate((curves.loose_start, curves.loose_end))] = 0.0
    parts: list[Float64[np.ndarray, "m 2"]] = []
    lengths: list[int] = []
    for k, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        before = _continuation(point[a], outward[k], float(reach[k]))[::-1]
        after = _continuation(point[b], outward[k + len(first)], float(reach[k + len(first)]))
        parts += [before, point[a : b + 1], after]
        lengths.append(len(before) + b + 1 - a + len(after))
    longer = Pieces(np.repeat(np.arange(len(lengths)), lengths))
    return Curves(*evenly_spaced(np.concatenate(parts), longer, SPACING_PX), curves.loose_start, curves.loose_end)


def _reach(
    coverage: Float32[np.ndarray, "h w"],
    start: Float64[np.ndarray, "k 2"],
    direction: Float64[np.ndarray, "k 2"],
    at: Float64[np.ndarray, "t"],
) -> Float64[np.ndarray, "k"]:
    """How far beyond each start, at the most to the last of `at`, the coverage falls below one half."""
    along = sample(coverage, start, direction, at)
    below = along < HALF
    k, here = np.argmax(below, axis=0), np.arange(len(start))
    inside, outside = along[np.maximum(k - 1, 0), here], along[k, here]
    share = (inside - HALF) / np.maximum(inside - outside, 1e-6)
    reach = at[k - 1] + share * (at[k] - at[k - 1])
    return np.where(below.any(axis=0), np.where(k > 0, reach, at[0]), at[-1])


def _continuation(
    start: Float64[np.ndarray, "2"], direction: Float64[np.ndarray, "2"], reach: float
) -> Float64[np.ndarray, "m 2"]:
    """Points after `start`, a pixel apart, the last at the end of its reach."""
    steps = np.arange(1.0, float(np.floor(reach)) + 1)
    if reach - np.floor(reach) > 0.05:
        steps = np.append(steps, reach)
    return start + steps[:, None] * direction
