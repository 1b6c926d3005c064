"""Whether promised probabilities hold: how often grasps of a promise came true, and how much better than no promise.

The Brier score is the mean of (p − o)² over trials with promise p and outcome o, 0 or 1; its skill is 1 − BS / BS₀
with BS₀ that of always promising the base rate (Brier, Monthly Weather Review 78, 1950; Murphy, J. Appl. Meteorol. 12,
1973).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.evaluation.came import Came

EDGES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Of the bins; where most promises lie they are narrow."""
ENOUGH = 200
"""With fewer trials a bin tells little."""


@dataclass(frozen=True)
class Bin:
    """Trials whose promise lies from `low` to `high`: how many, their mean promise, and the share that held."""

    low: float
    high: float
    trials: int
    promised: float
    held: float

    @property
    def off(self) -> float:
        """The share that held less what was promised."""
        return self.held - self.promised


@dataclass(frozen=True)
class Reliability:
    """Of all trials of a row that came to a grasp.

    Fields:
        brier, base: the score, and that of always promising the base rate.
    """

    trials: int
    bins: tuple[Bin, ...]
    brier: float
    base: float

    @property
    def skill(self) -> float | None:
        """1 for perfect promises, 0 for none better than the base rate; None where all came alike."""
        return 1.0 - self.brier / self.base if self.base > 0 else None

    @property
    def worst_off(self) -> float | None:
        """Of the bins with enough trials, how far the worst is off; None where there is none."""
        return max((abs(b.off) for b in self.bins if b.trials >= ENOUGH), default=None)


def reliability(came: Sequence[Came]) -> Reliability | None:
    """Of the trials that came to a grasp; None where there is none."""
    told = [(one.probability, one.outcome == "held") for one in came if one.outcome != "declined"]
    table = np.array([(p, held) for p, held in told if p is not None], np.float64).reshape(-1, 2)
    if not len(table):
        return None
    promised, held = table.T
    # the last bin holds its upper edge too
    place = np.clip(np.searchsorted(EDGES, promised, side="right") - 1, 0, len(EDGES) - 2)
    bins = tuple(
        Bin(low, high, int(inside.sum()), float(promised[inside].mean()), float(held[inside].mean()))
        for i, (low, high) in enumerate(itertools.pairwise(EDGES))
        if (inside := place == i).any()
    )
    base = float(held.mean() * (1.0 - held.mean()))
    return Reliability(len(table), bins, float(np.mean((promised - held) ** 2)), base)
