"""What the trials of an evaluation come to: counts and rates of each row of the table, and how sure they are.

Goals on one thread share its reconstruction and are not independent, so intervals come from drawing whole threads anew
(shared/success_rates.py). McNemar's test of paired goals stands beside them, and takes goals for independent.

Whether promised probabilities hold is told by how often grasps of a promise came true, and how much better than no
promise.

The Brier score is the mean of (p − o)² over trials with promise p and outcome o, 0 or 1; its skill is 1 − BS / BS₀
with BS₀ that of always promising the base rate (Brier, Monthly Weather Review 78, 1950; Murphy, J. Appl. Meteorol. 12,
1973).
"""

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from agents.simulated_trials.look import Came
from agents.simulated_trials.protocol import Protocol
from shared.published_rates import TOTALS, published_rate
from shared.success_rates import Interval, difference_over_threads, mcnemar, rate_over_threads, wilson

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


Row = tuple[str, str]
"""Method and policy."""


@dataclass(frozen=True)
class Rate:
    """Successes among the trials that came to a grasp; `declined` are apart."""

    held: int
    tried: int
    declined: int
    over_threads: Interval | None = None

    @property
    def share(self) -> float | None:
        """None where nothing was tried."""
        return self.held / self.tried if self.tried else None

    @property
    def asked(self) -> float | None:
        """As if what was declined had failed."""
        every = self.tried + self.declined
        return self.held / every if every else None

    @property
    def interval(self) -> Interval | None:
        """Wilson's, 95 %."""
        return wilson(self.held, self.tried)


@dataclass(frozen=True)
class Compared:
    """Two rows on the goals that both tried: both held, the first alone, the second alone, neither."""

    first: Row
    second: Row
    pairs: tuple[int, int, int, int]
    difference: float | None
    over_threads: Interval | None

    @property
    def p_value(self) -> float | None:
        """Of McNemar's exact test."""
        return mcnemar(self.pairs[1], self.pairs[2])


@dataclass(frozen=True)
class Durations:
    """Mean seconds from armed to finished, the least that the speed limits allow, and the mean share of the two."""

    took_s: float
    least_s: float
    ratio: float


@dataclass(frozen=True)
class Checks:
    """What the planner's own checks said of last attempts.

    Fields:
        said: how many checks said HELD, MISSED, UNKNOWN.
        falsely_held, falsely_missed: how many of those that said so were wrong.
        attempts: how many goals took how many attempts.
    """

    said: dict[str, int]
    falsely_held: int
    falsely_missed: int
    attempts: dict[int, int]


@dataclass(frozen=True)
class Results:
    """Everything that the table says, for one size of the tool's error, or all (None).

    Fields:
        rates: of each row by scenario, then of all.
        published: of each policy by scenario, then of all, in percent.
    """

    tool_error_mm: float | None
    scenarios: tuple[str, ...]
    rows: tuple[Row, ...]
    rates: dict[Row, tuple[Rate, ...]]
    published: dict[str, tuple[float | None, ...]]
    compared: tuple[Compared, ...]
    reliability: dict[Row, Reliability | None]
    causes: dict[Row, dict[str, int]]
    declined: dict[Row, dict[str, int]]
    durations: dict[Row, Durations | None]
    checks: dict[Row, Checks | None]


def results_of(protocol: Protocol, came: Sequence[Came], tool_error_mm: float | None = None) -> Results:
    """What the trials with one size of the tool's error have come to so far, or with any."""
    own = [one for one in came if tool_error_mm in (None, one.trial.tool_error_mm)]
    rows = tuple((method, policy) for method in protocol.methods for policy in protocol.policies)
    by_row = {row: [one for one in own if (one.trial.method, one.trial.policy) == row] for row in rows}
    return Results(
        tool_error_mm=tool_error_mm,
        scenarios=protocol.scenarios,
        rows=rows,
        rates={row: _rates(protocol, by_row[row]) for row in rows},
        published={policy: _published(protocol, policy) for policy in protocol.policies},
        compared=tuple(_compared(protocol, by_row, *pair) for pair in _pairs(rows)),
        reliability={row: reliability(by_row[row]) for row in rows},
        causes={row: _codes(by_row[row], "failed") for row in rows},
        declined={row: _codes(by_row[row], "declined") for row in rows},
        durations={row: _durations(by_row[row]) for row in rows},
        checks={row: _checks(by_row[row]) for row in rows},
    )


def rate_of(came: Iterable[Came], seed: int) -> Rate:
    """Of some trials."""
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for one in came:
        counts[one.trial.laid.name][one.outcome] += 1
    table = np.array([[c["held"], c["held"] + c["failed"], c["declined"]] for c in counts.values()], np.int64)
    table = table.reshape(-1, 3)
    held, tried, declined = (int(count) for count in table.sum(axis=0))
    return Rate(held, tried, declined, rate_over_threads(table[:, :2], seed))


def _rates(protocol: Protocol, came: list[Came]) -> tuple[Rate, ...]:
    each = (rate_of([o for o in came if o.trial.laid.scenario == name], protocol.seed) for name in protocol.scenarios)
    return (*each, rate_of(came, protocol.seed))


def _published(protocol: Protocol, policy: str) -> tuple[float | None, ...]:
    each = (published_rate(policy, *name.split("/")) for name in protocol.scenarios)
    return (*each, TOTALS[policy])


def _pairs(rows: tuple[Row, ...]) -> list[tuple[Row, Row]]:
    """Rows that differ in the policy alone, and those that differ in the method alone."""
    found = [(a, b) for i, a in enumerate(rows) for b in rows[i + 1 :]]
    return [(a, b) for a, b in found if (a[0] == b[0]) != (a[1] == b[1])]


def _compared(protocol: Protocol, by_row: dict[Row, list[Came]], first: Row, second: Row) -> Compared:
    outcomes: defaultdict[tuple[str, int, float], dict[Row, bool]] = defaultdict(dict)
    for row in (first, second):
        for one in by_row[row]:
            if one.outcome != "declined":
                place = one.trial.laid.name, one.trial.goal, one.trial.tool_error_mm
                outcomes[place][row] = one.outcome == "held"
    both = {place: pair for place, pair in outcomes.items() if len(pair) == 2}
    seen = Counter((pair[first], pair[second]) for pair in both.values())
    threads: defaultdict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for (name, *_), pair in both.items():
        counts = threads[name]
        for i, row in enumerate((first, second)):
            counts[2 * i] += pair[row]
            counts[2 * i + 1] += 1
    total = len(both)
    gained = seen[False, True] - seen[True, False]
    return Compared(
        first,
        second,
        (seen[True, True], seen[True, False], seen[False, True], seen[False, False]),
        gained / total if total else None,
        difference_over_threads(np.array(list(threads.values()), np.int64).reshape(-1, 4), protocol.seed),
    )


def _codes(came: list[Came], outcome: str) -> dict[str, int]:
    return dict(Counter(one.code for one in came if one.outcome == outcome).most_common())


def _durations(came: list[Came]) -> Durations | None:
    took = np.array([(o.took_s, o.least_s) for o in came if o.took_s and o.least_s], np.float64).reshape(-1, 2)
    if not len(took):
        return None
    return Durations(float(took[:, 0].mean()), float(took[:, 1].mean()), float((took[:, 0] / took[:, 1]).mean()))


def _checks(came: list[Came]) -> Checks | None:
    checked = [one for one in came if one.said is not None]
    if not checked:
        return None
    return Checks(
        said=dict(Counter(one.said for one in checked if one.said).most_common()),
        falsely_held=sum(one.said == "HELD" and one.outcome == "failed" for one in checked),
        falsely_missed=sum(one.said == "MISSED" and one.outcome == "held" for one in checked),
        attempts=dict(sorted(Counter(one.attempts for one in came if one.outcome != "declined").items())),
    )
