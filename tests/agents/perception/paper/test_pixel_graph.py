"""Distances along drawn pixels, against paths counted by hand and a plain shortest-path search."""

import heapq

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from agents.perception.paper.pixel_graph import distances_along, neighbour_matrix, step_lengths

masks = hnp.arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.booleans())


def shortest_from(start, pixels):
    """Dijkstra's search over a set of pixels, by the book."""
    distance, queue = {}, [(0.0, start)]
    while queue:
        so_far, (r, c) = heapq.heappop(queue)
        if (r, c) in distance:
            continue
        distance[r, c] = so_far
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                if (r + dr, c + dc) in pixels and (dr, dc) != (0, 0):
                    heapq.heappush(queue, (so_far + (dr * dr + dc * dc) ** 0.5, (r + dr, c + dc)))
    return distance


@settings(max_examples=60, deadline=None)
@given(mask=masks)
def test_distances_agree_with_a_search_by_the_book(mask):
    pixel = np.argwhere(mask)
    along, piece = distances_along(step_lengths(pixel, mask.shape))
    everywhere = {(int(r), int(c)) for r, c in pixel}
    for number in np.unique(piece):
        members = np.flatnonzero(piece == number)
        start = members[np.argmin(along[members])]
        reached = shortest_from(tuple(pixel[start].tolist()), everywhere)
        assert set(reached) == {tuple(p) for p in pixel[members].tolist()}
        np.testing.assert_allclose(along[members], [reached[tuple(p)] for p in pixel[members].tolist()])


@settings(max_examples=40, deadline=None)
@given(mask=masks, radius=st.integers(0, 3))
def test_neighbours_are_the_pixels_within_the_window(mask, radius):
    pixel = np.argwhere(mask)
    expected = (np.abs(pixel[:, None] - pixel[None]) <= radius).all(axis=2)
    np.testing.assert_array_equal(neighbour_matrix(pixel, mask.shape, radius).toarray() > 0, expected)
