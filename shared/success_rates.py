"""How sure a success rate is, and whether one policy grasps more often than another.

Wilson's interval of a share of n trials is where (k/n − p)² = z² p (1 − p) / n (Wilson, J. Am. Stat. Assoc. 1927).
McNemar's exact test looks only at the pairs in which the two policies differ: were both as good, each such pair would
be one or the other with probability 1/2 (McNemar, Psychometrika 1947). Both take trials for independent. Goals on one
thread are not, for they share its reconstruction; so the interval of the difference comes from drawing whole threads,
with replacement (the cluster bootstrap: Davison and Hinkley, Bootstrap Methods and their Application, 1997, 3.8).
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

Z_95 = 1.959963984540054
SHARE = 95.0
RESAMPLES = 10_000
FEWEST_THREADS = 2
"""A single thread says nothing of how threads differ."""


class Interval(NamedTuple):
    """From where to where."""

    low: float
    high: float


def wilson(successes: int, trials: int) -> Interval | None:
    """The 95 % interval of a success rate; None without trials."""
    if trials == 0:
        return None
    share, z2 = successes / trials, Z_95**2
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    return Interval(max(0.0, centre - half), min(1.0, centre + half))


def mcnemar(first_only: int, second_only: int) -> float | None:
    """How likely pairs that differ are at least so lopsided by chance, two-sided; None where none differs."""
    differ = first_only + second_only
    if differ == 0:
        return None
    tail = sum(math.comb(differ, k) for k in range(min(first_only, second_only) + 1))
    return min(1.0, 2 * tail / 2**differ)


def difference_over_threads(counts: Int64[np.ndarray, "threads 4"], seed: int = 0) -> Interval | None:
    """The 95 % interval of the second policy's success rate less the first's, threads being drawn anew.

    The columns: successes and trials of the first policy, successes and trials of the second. None where there are
    fewer than two threads that both were tried on.
    """
    usable = counts[(counts[:, 1] > 0) & (counts[:, 3] > 0)]
    if len(usable) < FEWEST_THREADS:
        return None
    rng = np.random.default_rng(seed)
    drawn = usable[rng.integers(len(usable), size=(RESAMPLES, len(usable)))].sum(axis=1)
    low, high = np.percentile(difference(drawn), [(100 - SHARE) / 2, (100 + SHARE) / 2])
    return Interval(float(low), float(high))


def rate_over_threads(counts: Int64[np.ndarray, "threads 2"], seed: int = 0) -> Interval | None:
    """The 95 % interval of a success rate, threads being drawn anew; the columns: successes and trials.

    None where there are fewer than two threads that were tried on.
    """
    usable = counts[counts[:, 1] > 0]
    if len(usable) < FEWEST_THREADS:
        return None
    rng = np.random.default_rng(seed)
    drawn = usable[rng.integers(len(usable), size=(RESAMPLES, len(usable)))].sum(axis=1)
    low, high = np.percentile(drawn[:, 0] / drawn[:, 1], [(100 - SHARE) / 2, (100 + SHARE) / 2])
    return Interval(float(low), float(high))


def difference(counts: Int64[np.ndarray, "n 4"]) -> Float64[np.ndarray, "n"]:
    """The second policy's success rate less the first's, of each row of counts as above."""
    return counts[:, 2] / counts[:, 3] - counts[:, 0] / counts[:, 1]
