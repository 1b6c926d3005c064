"""Sub-pixel centrelines: skeleton, then three rounds of correction across the normal, and the ends after the first.

Anti-aliased coverage is corrected by its centroid, which hardly depends on where a strip lies on the pixel grid. A mask
that only says yes or no has lost what is finer than a pixel, so there the edges in the image tell.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8

from agents.perception.centrelines.along import Pieces, directions, evenly_spaced, gaussian, local_quadratic, smoothed
from agents.perception.centrelines.deviation import deviations
from agents.perception.centrelines.edges import contrast_channel
from agents.perception.centrelines.profiles import sample
from agents.perception.centrelines.refine import Curves, by_coverage, by_edges, tangent_sigma
from agents.perception.centrelines.skeleton import Paths, skeleton_paths
from schemas.messages import Centrelines, no_centrelines

SEGMENTED_COVERAGE = 96
"""Coverage from which a pixel counts as thread; the same as where pixels are matched."""
GROUND_PX = 12
"""Around the thread that is looked at."""
SPACING_PX = 1.0
WIDEST_PX = 40.0
"""Profiles reach no further for a thread wider than this."""
LEAST_GRADED_SHARE = 0.1
"""Of the pixels beside the mask; of anti-aliased coverage most are partly thread, of a binary mask none."""
GLINT_WIDENING, LONGEST_GLINT = 2.0, 8.0
"""Of the usual width: what a strand with a filled hole may measure; of its square: the area of the largest hole."""
MOST_HOLES = 200
"""A mask with more is noise, of which nothing can be told."""
LEAST_LENGTH = 1.5
"""Pieces shorter than so many widths are no line."""


def thread_centrelines(
    image: UInt8[np.ndarray, "h w 3"],
    coverage: UInt8[np.ndarray, "h w"],
) -> Centrelines:
    """The middle of the thread in one rectified image.

    Args:
        image: BGR.
        coverage: by thread, 0 to 255; anti-aliased, or binary.
    """
    mask = coverage >= SEGMENTED_COVERAGE
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return no_centrelines()
    corner = np.array([max(columns[0] - GROUND_PX, 0), max(rows[0] - GROUND_PX, 0)])
    box = np.s_[corner[1] : rows[-1] + 1 + GROUND_PX, corner[0] : columns[-1] + 1 + GROUND_PX]
    found = _centrelines(image[box], np.ascontiguousarray(coverage[box], np.float32), mask[box])
    inside = np.clip(found.point_px + corner, 0.0, np.array(coverage.shape[::-1]) - 1.0)
    return Centrelines(inside, found.piece, found.width_px, found.deviation_px)


def _centrelines(
    image: UInt8[np.ndarray, "h w 3"], coverage: Float32[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]
) -> Centrelines:
    filled, depth = _without_glints(mask)
    # never less than the thread's, and up to two pixels more
    width = min(WIDEST_PX, max(1.0, 4.0 * float(depth[filled].mean())))
    curves = _initial(skeleton_paths(filled, depth), width)
    if len(curves.point) == 0:
        return no_centrelines()
    curves, _ = by_coverage(curves, coverage, width)
    curves = _extended(curves, coverage, width)
    curves, seen = by_coverage(curves, coverage, width)
    graded = _is_graded(coverage, mask)
    if graded:
        curves, seen = by_coverage(curves, coverage, width)
    else:
        curves, seen = by_edges(curves, seen, contrast_channel(image, mask), width)
    return Centrelines(curves.point, curves.pieces.number, seen.width_px, deviations(curves, seen, graded))


def _is_graded(coverage: Float32[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]) -> bool:
    """Whether the coverage fades at the mask's border, as anti-aliased coverage does; if not, it has no sub-pixels."""
    beside = np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))) > 0
    outside = coverage[beside & ~mask]
    return len(outside) > 0 and float((outside > 0).mean()) > LEAST_GRADED_SHARE


def _without_glints(mask: Bool[np.ndarray, "h w"]) -> tuple[Bool[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """The mask with holes filled that lie within a single strand, and its distance transform."""
    depth = _depth(mask)
    # over a strip the distance to the nearest pixel beyond its edge averages a quarter of its width, and a half
    width = max(1.0, 4.0 * float(depth[mask].mean()) - 2.0)
    image = mask.astype(np.uint8)
    outlines, hierarchy = cv2.findContours(image, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outer = np.asarray(hierarchy, np.int64).reshape(-1, 4)[:, 3]
    holes = [np.asarray(outlines[k]) for k in np.flatnonzero(outer >= 0).tolist()]
    if len(holes) > MOST_HOLES:
        return mask, depth
    within = [hole for hole in holes if _is_within_a_strand(image, hole, width)]
    if not within:
        return mask, depth
    cv2.drawContours(image, within, -1, 1, cv2.FILLED)
    return image > 0, _depth(image > 0)


def _is_within_a_strand(image: UInt8[np.ndarray, "h w"], hole: Int32[np.ndarray, "p 1 2"], width: float) -> bool:
    """Whether the mask is no wider around a hole than one strand; beside a gap between two it is twice that."""
    if cv2.contourArea(hole) > LONGEST_GLINT * width**2:
        return False
    margin = int(np.ceil(2 * width)) + 1
    left, top = np.maximum(hole[:, 0].min(axis=0) - margin, 0)
    right, bottom = hole[:, 0].max(axis=0) + margin + 1
    inside = np.zeros((bottom - top, right - left), np.uint8)
    cv2.drawContours(inside, [(hole - [[left, top]]).astype(np.int32)], -1, 1, cv2.FILLED)
    around = image[top:bottom, left:right] | inside[: image.shape[0] - top, : image.shape[1] - left]
    # beyond the cut-out the thread goes on, so that its border is no edge
    depth = cv2.distanceTransform(np.pad(around, 1, mode="edge"), cv2.DIST_L2, 3)[1:-1, 1:-1]
    return float(depth[inside[: depth.shape[0], : depth.shape[1]] > 0].max()) <= GLINT_WIDENING * width / 2 + 0.5


def _depth(mask: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    padded = np.pad(mask, 1).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 3), np.float32)[1:-1, 1:-1]


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
    tangent = directions(curves.point, curves.pieces, gaussian(tangent_sigma(width)))
    at = np.arange(0.0, 2 * width + 4, 0.25)
    none = np.zeros((0, 2))
    parts: list[Float64[np.ndarray, "m 2"]] = []
    lengths: list[int] = []
    for k, (a, b) in enumerate(zip(curves.pieces.first.tolist(), curves.pieces.last.tolist(), strict=True)):
        before = _continuation(coverage, curves.point[a], -tangent[a], at)[::-1] if curves.loose_start[k] else none
        after = _continuation(coverage, curves.point[b], tangent[b], at) if curves.loose_end[k] else none
        parts += [before, curves.point[a : b + 1], after]
        lengths.append(len(before) + b + 1 - a + len(after))
    pieces = Pieces(np.repeat(np.arange(len(lengths)), lengths))
    point, pieces = evenly_spaced(np.concatenate(parts), pieces, SPACING_PX)
    return Curves(point, pieces, curves.loose_start, curves.loose_end)


def _continuation(
    coverage: Float32[np.ndarray, "h w"],
    start: Float64[np.ndarray, "2"],
    direction: Float64[np.ndarray, "2"],
    at: Float64[np.ndarray, "t"],
) -> Float64[np.ndarray, "m 2"]:
    """Points after `start`, a pixel apart, the last where the coverage falls below one half."""
    along = sample(coverage, start[None], direction[None], at)[0]
    below = np.flatnonzero(along < 127.5)
    reach = float(at[below[0]] if len(below) else at[-1])
    if len(below) and below[0] > 0:
        k = below[0]
        reach = at[k - 1] + (along[k - 1] - 127.5) / max(along[k - 1] - along[k], 1e-6) * (at[k] - at[k - 1])
    steps = np.arange(1.0, float(np.floor(reach)) + 1)
    if reach - np.floor(reach) > 0.05 and reach > 0:
        steps = np.append(steps, reach)
    return start + steps[:, None] * direction
