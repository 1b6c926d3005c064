"""The richest way against all ways there are."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agents.reconstruction.refined.ways import richest_way


def worth(way, cost, prize):
    """A way's prizes without its links' costs."""
    earned = sum(prize[p] for p, _ in way)
    links = 0.0
    for (p, forward), (q, next_forward) in itertools.pairwise(way):
        links += cost[2 * p + forward, 2 * q + (not next_forward)]
    return earned - links


def all_ways(count):
    for size in range(1, count + 1):
        for order in itertools.permutations(range(count), size):
            for directions in itertools.product((False, True), repeat=size):
                yield list(zip(order, directions, strict=True))


@given(count=st.integers(1, 4), seed=st.integers(0, 10_000), missing=st.sampled_from((0.0, 0.5, 1.0)))
def test_no_way_is_richer(count, seed, missing):
    rng = np.random.default_rng(seed)
    cost, prize = rng.uniform(0, 3, (2 * count, 2 * count)), rng.uniform(0, 2, count)
    cost[rng.random(cost.shape) < missing] = np.inf
    found = richest_way(cost, prize)
    assert len({p for p, _ in found}) == len(found)
    best = max(worth(way, cost, prize) for way in all_ways(count))
    assert np.isclose(worth(found, cost, prize), best)


def test_what_costs_more_than_it_earns_is_left_out():
    cost = np.full((6, 6), 5.0)
    cost[1, 2] = 0.5
    assert richest_way(cost, np.array([10.0, 3.0, 4.0])) == [(0, True), (1, True)]
