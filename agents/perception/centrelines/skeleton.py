"""From a mask to ordered paths of skeleton pixels: spurs pruned, cut where strands meet or cross."""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from scipy.sparse import csgraph

from agents.perception.centrelines.thinning import NEIGHBOURS, neighbour_codes, neighbour_offsets, thin, thin_corners

SPUR_LENGTH = 1.5
"""Branches up to so many half widths long are bumps of the mask's border, no thread."""
FOLD_LENGTH, FOLD_COSINE = 3.0, 0.5
"""Up to so many half widths long is the end that two strands have in common, which leave it at so acute an angle: a
thread folded back beside the needle that it hangs on."""
CUT_RADIUS = 2.0
"""The skeleton is bent within so many half widths of a junction, and is cut there."""
PRUNING_ROUNDS = 2


@dataclass(frozen=True)
class Paths:
    """Pixels of a skeleton, in order along paths that do not branch.

    Fields:
        pixel: row and column.
        path: number of the path, from 0, never decreasing.
        loose_start, loose_end: whether a path's first and last pixel is an end of the skeleton, not a cut.
    """

    pixel: Int64[np.ndarray, "n 2"]
    path: Int64[np.ndarray, "n"]
    loose_start: Bool[np.ndarray, "k"]
    loose_end: Bool[np.ndarray, "k"]


def skeleton_paths(mask: Bool[np.ndarray, "h w"], depth: Float32[np.ndarray, "h w"]) -> Paths:
    """The skeleton of a mask as paths.

    Args:
        mask: the thread.
        depth: distance of each of its pixels to the nearest pixel outside.
    """
    image = np.zeros((mask.shape[0] + 2, mask.shape[1] + 2), np.uint8)
    pixel = thin(mask) + 1
    image[pixel[:, 0], pixel[:, 1]] = 1
    padded_depth = np.pad(depth, 1)
    for _ in range(PRUNING_ROUNDS):
        if not _prune(image, padded_depth):
            break
    return _traced(image, padded_depth)


def _prune(image: UInt8[np.ndarray, "h w"], depth: Float32[np.ndarray, "h w"]) -> bool:
    """Remove short branches that end freely; whether there were any."""
    index, degree = _pixels(image)
    junction = degree >= 3
    if not junction.any():
        return False
    flat, offsets = image.ravel(), neighbour_offsets(image.shape[1])
    of_pixel = _numbering(image, index)
    neighbours = of_pixel[index[:, None] + offsets]
    count, branch = _connected(neighbours, ~junction)
    ends_freely = np.bincount(branch[(degree <= 1) & ~junction], minlength=count) > 0
    # a branch may touch several pixels of a junction: the deepest says how wide the thread is there
    beside = neighbours[junction]
    reach = np.repeat(depth.ravel()[index[junction]], 8).reshape(-1, 8)
    touching = (beside >= 0) & ~junction[beside]
    limit = np.zeros(count)
    np.maximum.at(limit, branch[beside[touching]], reach[touching])
    length = np.bincount(branch[~junction], minlength=count)
    spur = ends_freely & (limit > 0) & (length <= SPUR_LENGTH * limit + 1)
    longer = ends_freely & (limit > 0) & ~spur & (length <= FOLD_LENGTH * limit + 1)
    place = np.column_stack((index // image.shape[1], index % image.shape[1])).astype(np.float64)
    for k in np.flatnonzero(longer).tolist():
        foot = np.flatnonzero(junction)[(touching & (branch[beside] == k)).any(axis=1)]
        spur[k] = _is_fold(place - place[foot].mean(axis=0), np.where(junction, -1, branch), k, float(limit[k]))
    removed = ~junction & spur[branch]
    flat[index[removed]] = 0
    thin_corners(flat, index[~removed], offsets, image.shape[1])
    return bool(removed.any())


def _is_fold(
    from_foot: Float64[np.ndarray, "p 2"], branch: Int64[np.ndarray, "p"], stub: int, half_width: float
) -> bool:
    """Whether the two branches beside a stub leave its foot side by side, away from it.

    Args:
        from_foot: the skeleton's pixels, from where the stub leaves.
        branch: of each pixel; −1 in junctions.
        stub: its branch.
        half_width: of the thread at its foot.
    """
    distance = np.hypot(from_foot[:, 0], from_foot[:, 1])
    meets = np.unique(branch[(distance <= half_width + 2) & (branch >= 0) & (branch != stub)])
    near = distance <= 2 * FOLD_LENGTH * half_width
    if len(meets) != 2:
        return False
    ways = [from_foot[near & (branch == k)].mean(axis=0) for k in (stub, *meets.tolist())]
    away, one, other = (way / max(float(np.hypot(*way)), 1e-9) for way in ways)
    return float(one @ other) > FOLD_COSINE and max(float(away @ one), float(away @ other)) < 0


def _traced(image: UInt8[np.ndarray, "h w"], depth: Float32[np.ndarray, "h w"]) -> Paths:
    index, degree = _pixels(image)
    kept = np.ones(image.shape, np.uint8)
    stride = image.shape[1]
    for at in index[degree >= 3].tolist():
        row, column = divmod(at, stride)
        cv2.circle(kept, (column, row), int(np.ceil(CUT_RADIUS * depth[row, column])), 0, cv2.FILLED)
    whole = kept.ravel()[index] > 0
    image &= kept
    offsets = neighbour_offsets(stride)
    neighbours = _numbering(image, index[whole])[index[whole][:, None] + offsets]
    order, path = _walk(neighbours)
    at = index[whole][order]
    loose = degree[whole][order] == 1
    first = np.flatnonzero(np.diff(path, prepend=-1))
    last = np.append(first[1:], len(path)) - 1
    pixel = np.column_stack((at // stride - 1, at % stride - 1))
    return Paths(pixel, path, loose[first], loose[last] if len(path) else loose[:0])


def _pixels(image: UInt8[np.ndarray, "h w"]) -> tuple[Int64[np.ndarray, "p"], Int64[np.ndarray, "p"]]:
    """Indices of the skeleton's pixels and how many neighbours each has."""
    flat = image.ravel()
    index = np.flatnonzero(flat)
    return index, NEIGHBOURS[neighbour_codes(flat, index, neighbour_offsets(image.shape[1]))]


def _numbering(image: UInt8[np.ndarray, "h w"], index: Int64[np.ndarray, "p"]) -> Int64[np.ndarray, "a"]:
    number = np.full(image.size, -1)
    number[index] = np.arange(len(index))
    return number


def _connected(neighbours: Int64[np.ndarray, "p 8"], kept: Bool[np.ndarray, "p"]) -> tuple[int, Int64[np.ndarray, "p"]]:
    """Number of connected groups and the group of each pixel; pixels that are not kept stand alone."""
    rows, columns = np.nonzero((neighbours >= 0) & kept[neighbours] & kept[:, None])
    ones = np.ones(len(rows), np.int8)
    size = len(neighbours)
    graph = scipy.sparse.csr_matrix((ones, (rows, neighbours[rows, columns])), shape=(size, size))
    count, group = csgraph.connected_components(graph, directed=False)
    return count, group.astype(np.int64)


def _walk(neighbours: Int64[np.ndarray, "p 8"]) -> tuple[Int64[np.ndarray, "p"], Int64[np.ndarray, "p"]]:
    """Order of the pixels along paths, and the path of each; every pixel has at most two neighbours, −1 for none."""
    one, other = np.sort(neighbours, axis=1)[:, -2:].T
    # the next pixel is the sum of both neighbours less the one before; −1 stands before the first and after the last
    both: list[int] = (one + other).tolist()
    unvisited = bytearray(b"\1" * len(both))
    order: list[int] = []
    lengths: list[int] = []

    def follow(start: int, before: int) -> None:
        here, begun = start, len(order)
        while here >= 0 and unvisited[here]:
            unvisited[here] = 0
            order.append(here)
            here, before = both[here] - before, here
        lengths.append(len(order) - begun)

    for end in np.flatnonzero(one < 0).tolist():
        if unvisited[end]:
            follow(end, -1)
    while (start := unvisited.find(1)) >= 0:
        follow(start, int(one[start]))
    return np.array(order, np.int64), np.repeat(np.arange(len(lengths)), lengths)
