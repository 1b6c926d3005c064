"""From a mask to ordered paths of skeleton pixels: spurs pruned, cut where strands meet or cross."""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float32, Int64, UInt8
from scipy.sparse import csgraph

from agents.perception.centrelines.thinning import NEIGHBOURS, neighbour_codes, neighbour_offsets, thin_corners, thinned

SPUR_LENGTH = 1.5
"""Branches up to so many half widths long are bumps of the mask's border, no thread."""
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
    padded_depth = cv2.copyMakeBorder(depth, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    image = thinned(mask, padded_depth)
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
    neighbours = _neighbours(flat, index, offsets)
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
    removed = ~junction & spur[branch]
    flat[index[removed]] = 0
    thin_corners(flat, index[~removed], offsets, image.shape[1])
    return bool(removed.any())


def _traced(image: UInt8[np.ndarray, "h w"], depth: Float32[np.ndarray, "h w"]) -> Paths:
    index, degree = _pixels(image)
    stride = image.shape[1]
    for at in index[degree >= 3].tolist():
        row, column = divmod(at, stride)
        cv2.circle(image, (column, row), int(np.ceil(CUT_RADIUS * depth[row, column])), 0, cv2.FILLED)
    whole = image.ravel()[index] > 0
    order, path = _walk(_neighbours(image.ravel(), index[whole], neighbour_offsets(stride)))
    at = index[whole][order]
    loose = degree[whole][order] == 1
    first = np.flatnonzero(np.diff(path, prepend=-1))
    last = np.append(first[1:], len(path)) - 1
    pixel = np.column_stack((at // stride - 1, at % stride - 1))
    return Paths(pixel, path, loose[first], loose[last] if len(path) else loose[:0])


def _pixels(image: UInt8[np.ndarray, "h w"]) -> tuple[Int64[np.ndarray, "p"], Int64[np.ndarray, "p"]]:
    """Indices of the skeleton's pixels and how many neighbours each has."""
    flat = image.ravel()
    # NumPy looks through truth values many times faster than through numbers
    index = np.flatnonzero(flat.view(bool))
    return index, NEIGHBOURS[neighbour_codes(flat, index, neighbour_offsets(image.shape[1]))]


def _neighbours(
    flat: UInt8[np.ndarray, "a"], index: Int64[np.ndarray, "p"], offsets: Int64[np.ndarray, "8"]
) -> Int64[np.ndarray, "p 8"]:
    """The number of each pixel's eight neighbours among the pixels of an image that are set, −1 for none.

    Args:
        index: of the pixels that are set.
    """
    # only the places of these pixels are ever written or read, so that nothing else of it costs anything
    number = np.empty(len(flat), np.int64)
    number[index] = np.arange(len(index))
    wanted = index[:, None] + offsets
    found = np.full(wanted.shape, -1)
    is_set = flat[wanted] > 0
    found[is_set] = number[wanted[is_set]]
    return found


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
    unvisited = np.ones(len(both), bool)
    order: list[int] = []
    lengths: list[int] = []

    def follow(start: int, before: int) -> None:
        here, path = start, list[int]()
        while True:
            path.append(here)
            here, before = both[here] - before, here
            # a path ends, a loop returns
            if here < 0 or here == start:
                break
        unvisited[path] = False
        order.extend(path)
        lengths.append(len(path))

    for end in np.flatnonzero(one < 0).tolist():
        if unvisited[end]:
            follow(end, -1)
    while unvisited.any():
        start = int(np.argmax(unvisited))
        follow(start, int(one[start]))
    return np.array(order, np.int64), np.repeat(np.arange(len(lengths)), lengths)
