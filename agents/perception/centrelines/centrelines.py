"""Sub-pixel centrelines: skeleton, then the centroid across the normal, three rounds; then the ends.

Source: "Sub-pixel centrelines" of two-view refinement; the centroid of anti-aliased coverage is unbiased for a strip
of constant width, wherever it lies on the pixel grid.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from agents.perception.centrelines.along import bounds, directions, evenly_spaced, gaussian, local_quadratic, smoothed
from agents.perception.centrelines.profiles import Middle, middle, normals, offsets, own_strand, sample
from agents.perception.centrelines.skeleton import Paths, skeleton_paths
from schemas.messages import Centrelines, no_centrelines

SEGMENTED_COVERAGE = 96
"""Coverage from which a pixel counts as thread; the same as where pixels are matched."""
ROUNDS = 3
SPACING_PX = 1.0
MARGIN_PX = 2.0
"""Beyond the thread's own edge that a profile looks."""
WIDEST_PX = 40.0
"""Profiles reach no further for a thread wider than this."""
LEAST_LENGTH = 1.5
"""Pieces shorter than so many widths are no line."""


@dataclass(frozen=True)
class _Curves:
    point: Float64[np.ndarray, "n 2"]
    piece: Int64[np.ndarray, "n"]
    loose_start: Bool[np.ndarray, "k"]
    loose_end: Bool[np.ndarray, "k"]


def thread_centrelines(
    image: UInt8[np.ndarray, "h w 3"],  # noqa: ARG001
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
    corner = np.array([max(columns[0] - 2, 0), max(rows[0] - 2, 0)])
    box = np.s_[corner[1] : rows[-1] + 3, corner[0] : columns[-1] + 3]
    found = _centrelines(np.ascontiguousarray(coverage[box], np.float32), mask[box])
    inside = np.clip(found.point_px + corner, 0.0, np.array(coverage.shape[::-1]) - 1.0)
    return Centrelines(inside, found.piece, found.width_px, found.deviation_px)


def _centrelines(coverage: Float32[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]) -> Centrelines:
    filled, depth = _without_pinholes(mask)
    width = min(WIDEST_PX, max(1.0, 4.0 * float(depth[filled].mean())))
    curves = _initial(skeleton_paths(filled, depth), width)
    if len(curves.point) == 0:
        return no_centrelines()
    for _ in range(ROUNDS - 1):
        curves = _centred(curves, coverage, width)
    curves = _centred(_extended(curves, coverage, width), coverage, width)
    return _measured(curves, coverage, width)


def _without_pinholes(mask: Bool[np.ndarray, "h w"]) -> tuple[Bool[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """The mask with holes smaller than the thread's own width filled, and its distance transform."""
    depth = _depth(mask)
    # over a strip the distance to its edge averages a quarter of its width
    width = 4.0 * float(depth[mask].mean())
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] <= max(2.0, 0.5 * width**2)
    small[0] = False
    if not small.any():
        return mask, depth
    filled = mask | small[np.asarray(labels, np.int32)]
    return filled, _depth(filled)


def _depth(mask: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    padded = np.pad(mask, 1).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 3), np.float32)[1:-1, 1:-1]


def _initial(paths: Paths, width: float) -> _Curves:
    """Smoothed paths, evenly spaced, without what is too short and without the last half width before loose ends."""
    path = paths.path
    first, end = bounds(path)
    length = end - first
    index = np.arange(len(path))
    # the skeleton turns into a corner of a blunt end
    back = np.where(length > 3 * width, round(0.5 * width), 0)
    keep = (index >= (first + back * paths.loose_start)[path]) & (index < (end - back * paths.loose_end)[path])
    long_enough = length >= np.maximum(
        2, LEAST_LENGTH * width - paths.loose_start * width / 2 - paths.loose_end * width / 2
    )
    keep &= long_enough[path]
    point = paths.pixel[keep][:, ::-1].astype(np.float64)
    piece = np.cumsum(np.diff(path[keep], prepend=-1) > 0) - 1
    if len(point) == 0:
        return _Curves(point, piece, paths.loose_start[:0], paths.loose_end[:0])
    smooth = smoothed(point, piece, local_quadratic(_sigma(width)))
    point, piece = evenly_spaced(smooth, piece, SPACING_PX)
    return _Curves(point, piece, paths.loose_start[long_enough], paths.loose_end[long_enough])


def _sigma(width: float) -> float:
    return float(np.clip(0.5 * width, 2.0, 4.0))


def _profiles(
    curves: _Curves, coverage: Float32[np.ndarray, "h w"], width: float
) -> tuple[Float64[np.ndarray, "n 2"], Middle]:
    tangent = directions(curves.point, curves.piece, gaussian(_sigma(width)))
    normal = normals(tangent)
    at = offsets(width / 2 + MARGIN_PX)
    return normal, middle(own_strand(sample(coverage, curves.point, normal, at)), at)


def _centred(curves: _Curves, coverage: Float32[np.ndarray, "h w"], width: float) -> _Curves:
    normal, found = _profiles(curves, coverage, width)
    shift = np.clip(found.offset_px, -width / 2, width / 2)
    point = smoothed(curves.point + shift[:, None] * normal, curves.piece, local_quadratic(1.5))
    return _Curves(point, curves.piece, curves.loose_start, curves.loose_end)


def _extended(curves: _Curves, coverage: Float32[np.ndarray, "h w"], width: float) -> _Curves:
    """Curves continued straight to where the coverage ends, at loose ends."""
    first, end = bounds(curves.piece)
    tangent = directions(curves.point, curves.piece, gaussian(_sigma(width)))
    at = np.arange(0.0, 2 * width + 4, 0.25)
    pieces = []
    for k, (a, b) in enumerate(zip(first.tolist(), end.tolist(), strict=True)):
        before = after = np.zeros((0, 2))
        if curves.loose_start[k]:
            before = _continuation(coverage, curves.point[a], -tangent[a], at)[::-1]
        if curves.loose_end[k]:
            after = _continuation(coverage, curves.point[b - 1], tangent[b - 1], at)
        pieces.append(np.concatenate((before, curves.point[a:b], after)))
    piece = np.repeat(np.arange(len(pieces)), [len(p) for p in pieces])
    point, piece = evenly_spaced(np.concatenate(pieces), piece, SPACING_PX)
    return _Curves(point, piece, curves.loose_start, curves.loose_end)


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


def _measured(curves: _Curves, coverage: Float32[np.ndarray, "h w"], width: float) -> Centrelines:
    _, found = _profiles(curves, coverage, width)
    deviation = _deviation(found, width)
    return Centrelines(curves.point, curves.piece, np.maximum(found.width_px, 0.1), deviation)


def _deviation(found: Middle, width: float) -> Float64[np.ndarray, "n"]:
    typical = float(np.median(found.width_px))
    unusual = np.abs(found.width_px - typical)
    return 0.05 + 0.3 * np.maximum(unusual - 0.15 * typical, 0.0) + np.abs(found.offset_px) + 0.5 * width * found.open
