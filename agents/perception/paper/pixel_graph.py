"""Segmented pixels as a graph: who is whose neighbour, and how far along the thread one pixel lies from another."""

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64
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
