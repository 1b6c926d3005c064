"""Success over the size of the tool's error, and the error at which it falls to a given share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.evaluation.results import Rate, Results, Row

FALLS_TO = 0.95


@dataclass(frozen=True)
class Sweep:
    """A row's rates over the deviation of the tool's error, in millimetres.

    Fields:
        falls_at_mm: where the rate falls to 95 %, between two sizes on a straight line; None where it never does, or is
            lower from the start.
    """

    row: Row
    errors_mm: tuple[float, ...]
    rates: tuple[Rate, ...]
    falls_at_mm: float | None


def sweeps(every: Sequence[Results]) -> list[Sweep]:
    """One for each row, where several sizes were tried."""
    sized = [(results.tool_error_mm, results) for results in every if results.tool_error_mm is not None]
    if len(sized) < 2:
        return []
    sized.sort(key=lambda pair: pair[0])
    errors, ordered = tuple(size for size, _ in sized), [results for _, results in sized]
    result: list[Sweep] = []
    for row in ordered[0].rows:
        rates = tuple(results.rates[row][-1] for results in ordered)
        known = [(e, r.share) for e, r in zip(errors, rates, strict=True) if r.share is not None]
        result.append(Sweep(row, errors, rates, falls_at(known, FALLS_TO)))
    return result


def falls_at(curve: Sequence[tuple[float, float]], share: float) -> float | None:
    """Where a curve first falls to a share; None where it never does, or begins below it."""
    x, y = np.array(curve, np.float64).reshape(-1, 2).T
    below = np.flatnonzero(y <= share)
    if not len(below) or y[0] < share:
        return None
    after = int(below[0])
    if after == 0:
        return float(x[0])
    before = after - 1
    return float(x[before] + (y[before] - share) / (y[before] - y[after]) * (x[after] - x[before]))
