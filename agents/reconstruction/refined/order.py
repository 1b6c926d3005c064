"""Which points of a piece of centreline have places on a curve that follow each other, as those of one strand do."""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.reconstruction.refined.projection import chords

LEAP, LEAP_SHARE = 3.0, 0.008
"""Places of neighbours that are farther apart than so many times the points, and this share of the width, are no one
strand's."""
SHORTEST_RUN = 5


def in_order(
    place: Float64[np.ndarray, "n"],
    piece: Int64[np.ndarray, "n"],
    near: Bool[np.ndarray, "n"],
    points: Float64[np.ndarray, "n 2"],
    width: int,
) -> Bool[np.ndarray, "n"]:
    """Of each piece, the runs without leap that follow each other in one direction and hold most points."""
    kept = np.zeros(len(place), bool)
    usable = np.flatnonzero(near)
    if not len(usable):
        return kept
    step, at, on = chords(points[usable]), place[usable], piece[usable]
    leap = (np.abs(at[1:] - at[:-1]) > LEAP * step + LEAP_SHARE * width) | (on[1:] != on[:-1])
    bounds = (0, *(np.flatnonzero(leap) + 1), len(usable))
    runs = [usable[first:end] for first, end in pairwise(bounds) if end - first >= SHORTEST_RUN]
    for number in {int(piece[run[0]]) for run in runs}:
        own = [run for run in runs if piece[run[0]] == number]
        ways = (_longest_chain(own, place), _longest_chain(own, -place))
        for run in max(ways, key=lambda way: sum(len(run) for run in way)):
            kept[run] = True
    return kept


def _longest_chain(runs: list[Int64[np.ndarray, "k"]], place: Float64[np.ndarray, "n"]) -> list[Int64[np.ndarray, "k"]]:
    """The runs with rising places of which each begins after the one before, with most points in all."""
    rising = [run for run in runs if place[run[-1]] > place[run[0]]]
    best: list[list[np.ndarray]] = []
    for run in rising:
        before = [way for way in best if place[way[-1][-1]] <= place[run[0]]]
        best.append([*max(before, key=lambda way: sum(len(r) for r in way), default=[]), run])
    return max(best, key=lambda way: sum(len(r) for r in way), default=[])
