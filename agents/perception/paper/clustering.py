"""Clusters of matched pixels and their order along the thread (paper, section II-B).

The paper grows clusters and their order breadth first through the segmented pixels. Here both come from one
quantity, the distance of each pixel from an end of its connected piece, counted through the segmented pixels: cut
into intervals it gives the clusters, sorted by it they are in order.

For that, segmented pixels are a graph of neighbours.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float64, Int64
from scipy.sparse import csgraph


def neighbour_matrix(pixel: Int64[np.ndarray, "p 2"], shape: tuple[int, int], radius: int) -> scipy.sparse.csr_matrix:
    """Which pixels lie within a square window of each other, themselves included: (p, p), ones.

    Args:
        pixel: rows and columns of distinct pixels.
        shape: height and width of their image.
        radius: of the window, in pixels.
    """
    index = np.full((shape[0] + 2 * radius, shape[1] + 2 * radius), -1, dtype=np.int64)
    index[pixel[:, 0] + radius, pixel[:, 1] + radius] = np.arange(len(pixel))
    step = np.arange(2 * radius + 1)
    rows = pixel[:, 0, None, None] + step[:, None]
    columns = pixel[:, 1, None, None] + step[None, :]
    neighbour = index[rows, columns].reshape(len(pixel), step.size**2)
    found = neighbour >= 0
    indptr = np.concatenate(([0], np.cumsum(found.sum(axis=1))))
    ones = np.ones(indptr[-1], dtype=np.float32)
    return scipy.sparse.csr_matrix((ones, neighbour[found], indptr), shape=(len(pixel), len(pixel)))


def step_lengths(pixel: Int64[np.ndarray, "p 2"], shape: tuple[int, int]) -> scipy.sparse.csr_matrix:
    """The graph of 8-connected pixels with the length of each step, 1 or √2: (p, p)."""
    graph = neighbour_matrix(pixel, shape, 1).tocoo()
    apart = graph.row != graph.col
    row, column = graph.row[apart], graph.col[apart]
    length = np.linalg.norm((pixel[row] - pixel[column]).astype(np.float64), axis=1)
    return scipy.sparse.csr_matrix((length, (row, column)), shape=graph.shape)


def distances_along(graph: scipy.sparse.csr_matrix) -> tuple[Float64[np.ndarray, "p"], Int64[np.ndarray, "p"]]:
    """How far along its connected piece each pixel lies, and which piece that is.

    Distance is counted through the graph from one end of the piece. An end is the pixel farthest from any pixel: from
    an arbitrary one the farthest is an end of a thread without loops.
    """
    pieces, piece = csgraph.connected_components(graph, directed=False)
    _, anywhere = np.unique(piece, return_index=True)
    reached = csgraph.dijkstra(graph, indices=anywhere, min_only=True)
    end = _farthest_of_each(reached, piece, pieces)
    return csgraph.dijkstra(graph, indices=end, min_only=True), piece.astype(np.int64)


def _farthest_of_each(distance: np.ndarray, piece: np.ndarray, pieces: int) -> np.ndarray:
    order = np.lexsort((distance, piece))
    last = np.searchsorted(piece[order], np.arange(pieces), side="right") - 1
    return order[last]


LARGEST_SHARE, SMALLEST_SHARE = 0.01, 0.0025
"""A cluster holds at most the first, and at least the second share of the segmented pixels."""


@dataclass(frozen=True)
class Clusters:
    """Ordered clusters of matched pixels.

    Fields:
        centroid_px: (u, v) in the left image.
        half_size_px: half the extent (u, v) of the segmented pixels beside it.
        disparity_px: mean over the cluster's inliers, weighted so that its depth is their mean depth.
        segment: index of the connected stretch that the cluster belongs to; clusters of one are consecutive.
    """

    centroid_px: Float64[np.ndarray, "n 2"]
    half_size_px: Float64[np.ndarray, "n 2"]
    disparity_px: Float64[np.ndarray, "n"]
    segment: Int64[np.ndarray, "n"]


def cluster_and_order(
    pixel: Int64[np.ndarray, "p 2"],
    disparity_px: Float64[np.ndarray, "p"],
    inlier: Bool[np.ndarray, "p"],
    shape: tuple[int, int],
) -> Clusters:
    """Ordered clusters of the inliers among the segmented left pixels, joined into one thread.

    Args:
        pixel: row and column of every segmented left pixel.
        disparity_px: of each; only those of inliers are used.
        inlier: which have a match that counts.
        shape: height and width of the image.
    """
    graph = step_lengths(pixel, shape)
    along, piece = distances_along(graph)
    cluster = _cluster_of_each(graph, along, piece)
    cluster = _without_small(cluster, inlier, max(1.0, SMALLEST_SHARE * len(pixel)))
    if not (cluster >= 0).any():
        return Clusters(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.int64))
    measured = _measure(pixel, disparity_px, inlier, along, piece, cluster)
    return _joined(_with_ends(measured, pixel, along, piece))


@dataclass(frozen=True)
class _Measured:
    centroid_px: np.ndarray
    half_size_px: np.ndarray
    disparity_px: np.ndarray
    along: np.ndarray
    piece: np.ndarray

    def take(self, index: np.ndarray) -> "_Measured":
        return _Measured(*(value[index] for value in vars(self).values()))


def _cluster_of_each(graph: scipy.sparse.csr_matrix, along: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Connected runs of equally many pixels along each piece: labels from 0.

    Where a piece has a loop, a run reaches both of its arms; they are clusters of their own.
    """
    pixels = len(along)
    order = np.lexsort((along, piece))
    rank = np.arange(pixels) - np.searchsorted(piece[order], piece[order])
    run = np.empty(pixels, dtype=np.int64)
    run[order] = rank // max(1, int(LARGEST_SHARE * pixels))
    edges = graph.tocoo()
    within = run[edges.row] == run[edges.col]
    connections = scipy.sparse.csr_matrix(
        (edges.data[within], (edges.row[within], edges.col[within])), shape=graph.shape
    )
    return csgraph.connected_components(connections, directed=False)[1]


def _without_small(cluster: np.ndarray, inlier: np.ndarray, least: float) -> np.ndarray:
    """Clusters with too few inliers are dropped: their pixels get the label −1."""
    counts = np.bincount(cluster, weights=inlier, minlength=cluster.max(initial=-1) + 1)
    return np.where(counts[cluster] >= least, cluster, -1)


def _measure(
    pixel: np.ndarray,
    disparity_px: np.ndarray,
    inlier: np.ndarray,
    along: np.ndarray,
    piece: np.ndarray,
    cluster: np.ndarray,
) -> _Measured:
    """One row a cluster, sorted along each piece."""
    used = inlier & (cluster >= 0)
    label, row = np.unique(cluster[used], return_inverse=True)
    count = np.bincount(row)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(row, weights=values[used]) / count

    whole = cluster >= 0
    member = np.searchsorted(label, cluster[whole])
    uv = pixel[whole][:, ::-1].astype(np.float64)
    low, high = np.full((len(label), 2), np.inf), np.full((len(label), 2), -np.inf)
    np.minimum.at(low, member, uv)
    np.maximum.at(high, member, uv)

    measured = _Measured(
        centroid_px=np.column_stack((mean(pixel[:, 1]), mean(pixel[:, 0]))),
        half_size_px=0.5 * (high - low + 1.0),
        disparity_px=1.0 / mean(1.0 / np.maximum(disparity_px, 1.0)),
        along=mean(along),
        piece=np.round(mean(piece)).astype(np.int64),
    )
    return measured.take(np.lexsort((measured.along, measured.piece)))


def _with_ends(measured: _Measured, pixel: np.ndarray, along: np.ndarray, piece: np.ndarray) -> _Measured:
    """Each piece extended to its farthest pixels, at the neighbouring cluster's depth.

    A piece of one pixel is its own end, and is not extended.
    """
    kept = np.unique(measured.piece)
    first = np.searchsorted(measured.piece, kept)
    last = np.searchsorted(measured.piece, kept, side="right") - 1
    order = np.lexsort((along, piece))
    near_end = order[np.searchsorted(piece[order], kept)]
    far_end = order[np.searchsorted(piece[order], kept, side="right") - 1]
    columns: dict[str, np.ndarray] = {}
    for name, value in vars(measured).items():
        columns[name] = np.concatenate((value, value[first], value[last]))
    ends = np.concatenate((near_end, far_end))
    count = len(measured.piece)
    columns["centroid_px"][count:] = pixel[ends][:, ::-1]
    columns["along"][count:] = along[ends]
    extended = _Measured(**columns)
    beside = np.concatenate((first, last))
    moved = (extended.centroid_px[count:] != measured.centroid_px[beside]).any(axis=1)
    kept_rows = np.flatnonzero(np.concatenate((np.ones(count, bool), moved)))
    extended = extended.take(kept_rows)
    return extended.take(np.lexsort((extended.along, extended.piece)))


def _joined(measured: _Measured) -> Clusters:
    """The pieces strung together over their nearest ends; it begins at the end with the smaller u (then v)."""
    pieces = np.unique(measured.piece)
    members = [np.flatnonzero(measured.piece == p) for p in pieces]
    ends = np.array([measured.centroid_px[[m[0], m[-1]]] for m in members])
    chain = _short_tour(ends)
    index = np.concatenate([members[p][::-1] if reverse else members[p] for p, reverse in chain])
    segment = np.concatenate([np.full(len(members[p]), k) for k, (p, _) in enumerate(chain)])
    if tuple(measured.centroid_px[index[-1]]) < tuple(measured.centroid_px[index[0]]):
        index, segment = index[::-1], segment[-1] - segment[::-1]
    ordered = measured.take(index)
    return Clusters(ordered.centroid_px, ordered.half_size_px, ordered.disparity_px, segment.astype(np.int64))


def _short_tour(ends: Float64[np.ndarray, "k 2 2"]) -> list[tuple[int, bool]]:
    """Pieces in the order of a short path through all of them, each with whether it is walked backwards.

    Greedy: the nearest two free ends of different chains are joined until one chain is left.
    """
    count = len(ends)
    points = ends.reshape(-1, 2)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    first, second = np.triu_indices(2 * count, 1)
    chain_of, partner = list(range(count)), [-1] * (2 * count)
    for link in np.argsort(distance[first, second], kind="stable"):
        a, b = int(first[link]), int(second[link])
        if partner[a] >= 0 or partner[b] >= 0 or chain_of[a // 2] == chain_of[b // 2]:
            continue
        partner[a], partner[b] = b, a
        old, new = chain_of[b // 2], chain_of[a // 2]
        chain_of = [new if c == old else c for c in chain_of]
    entry = next(end for end in range(2 * count) if partner[end] < 0)
    chain: list[tuple[int, bool]] = []
    while True:
        chain.append((entry // 2, entry % 2 == 1))
        leaving = entry ^ 1
        if partner[leaving] < 0:
            return chain
        entry = partner[leaving]
