"""The likeliest path, and the sum of all, against every path there is."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.reconstruction.refined.paths import Scores, ends_of, likeliest_path, log_total, score


def all_paths(count):
    for size in range(1, count + 1):
        for order in itertools.permutations(range(count), size):
            for directions in itertools.product((False, True), repeat=size):
                yield list(zip(order, directions, strict=True))


def drawn_scores(count, seed, missing):
    rng = np.random.default_rng(seed)
    join = rng.normal(0, 2, (2 * count, 2 * count))
    join += join.T
    join[(gone := rng.random(join.shape) < missing) | gone.T] = -np.inf
    return Scores(join, rng.normal(0, 2, count), rng.normal(0, 2, 2 * count))


@given(count=st.integers(1, 4), seed=st.integers(0, 10_000), missing=st.sampled_from((0.0, 0.5, 1.0)))
def test_no_path_is_likelier_and_all_together_are_summed(count, seed, missing):
    scores = drawn_scores(count, seed, missing)
    every = {tuple(path): score(path, scores) for path in all_paths(count)}
    assert score(likeliest_path(scores), scores) == pytest.approx(max(every.values()))
    through = seed % count
    of_piece = [value for path, value in every.items() if through in [p for p, _ in path]]
    assert score(likeliest_path(scores, through), scores) == pytest.approx(max(of_piece))
    assert log_total(scores, through) == pytest.approx(np.logaddexp.reduce(of_piece))


@given(seed=st.integers(0, 10_000))
def test_without_a_join_or_an_end_no_path_has_it(seed):
    scores = drawn_scores(3, seed, 0.0)
    for join in ends_of(likeliest_path(scores)):
        other = likeliest_path(scores.without_join(*join))
        assert join not in ends_of(other)
        assert join[::-1] not in ends_of(other)


def test_several_sets_of_pieces_are_summed_at_once():
    some = [drawn_scores(3, seed, 0.2) for seed in range(4)]
    together = Scores(*(np.stack([getattr(each, name) for each in some]) for name in ("join", "piece", "end")))
    through = np.array([0, 1, 2, 0])
    assert log_total(together, through) == pytest.approx([log_total(*each) for each in zip(some, through, strict=True)])


def test_what_costs_more_than_it_earns_is_left_out():
    join = np.full((6, 6), -5.0)
    join[1, 2] = join[2, 1] = -0.5
    assert likeliest_path(Scores(join, np.array([10.0, 3.0, 4.0]), np.zeros(6))) in (
        [(0, True), (1, True)],
        [(1, False), (0, False)],
    )
