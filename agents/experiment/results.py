"""What the attempts of an experiment come to: counts, rates, and how sure they are."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.experiment.journal import POLICIES, Attempt, Journal, PolicyName
from shared.published_rates import TOTALS, published_rate
from shared.success_rates import Interval, difference, difference_over_threads, mcnemar, wilson

DIRECT, ROBUST = POLICIES


@dataclass(frozen=True)
class Rate:
    """Successes among the trials that came to a grasp; `declined` are apart."""

    held: int
    tried: int
    declined: int
    published: float | None

    @property
    def percent(self) -> float | None:
        """None where nothing was tried."""
        return 100 * self.held / self.tried if self.tried else None

    @property
    def interval(self) -> Interval | None:
        """Of the success rate, Wilson's, 95 %."""
        return wilson(self.held, self.tried)


@dataclass(frozen=True)
class Results:
    """Everything that the table says.

    Fields:
        kinds: configuration and background of each column.
        rates: by policy, of each column and then of all.
        pairs: goals tried with both policies that held with both, with direct alone, with robust alone, with neither.
        difference: robust less direct, of all trials; None where one of them was not tried.
        over_threads: its interval, threads being drawn anew.
    """

    threads: int
    kinds: tuple[tuple[str, str], ...]
    rates: dict[PolicyName, tuple[Rate, ...]]
    pairs: tuple[int, int, int, int]
    difference: float | None
    over_threads: Interval | None
    causes: dict[PolicyName, dict[str, int]]
    execution_s: dict[PolicyName, float | None]
    repeats: int

    @property
    def p_value(self) -> float | None:
        """Of McNemar's exact test."""
        return mcnemar(self.pairs[1], self.pairs[2])


def results_of(journal: Journal) -> Results:
    """What an experiment has come to so far."""
    attempts = journal.attempts
    kinds = tuple(dict.fromkeys(_kind(thread) for thread in journal.protocol.threads))
    counts = np.array([_counts(attempts, thread) for thread in journal.protocol.threads], np.int64)
    total = counts.sum(axis=0, keepdims=True)
    return Results(
        threads=int((counts[:, [1, 3]] > 0).all(axis=1).sum()),
        kinds=kinds,
        rates={policy: _rates(attempts, policy, kinds) for policy in POLICIES},
        pairs=_pairs(attempts),
        difference=float(difference(total)[0]) if (total[:, [1, 3]] > 0).all() else None,
        over_threads=difference_over_threads(counts, journal.protocol.seed),
        causes={policy: _causes(attempts, policy) for policy in POLICIES},
        execution_s={policy: _mean_execution_s(attempts, policy) for policy in POLICIES},
        repeats=sum(attempt.repeats for attempt in attempts),
    )


def document(journal: Journal, results: Results) -> dict[str, Any]:
    """The same for programs, with every attempt."""

    def told(rate: Rate) -> dict[str, Any]:
        shown = {"held": rate.held, "tried": rate.tried, "declined": rate.declined, "percent": rate.percent}
        return shown | {"wilson_95": rate.interval, "published_percent": rate.published}

    names = ["/".join(kind) for kind in results.kinds] + ["total"]
    both, direct, robust, neither = results.pairs
    return {
        "protocol": journal.protocol.model_dump(),
        "threads_compared": results.threads,
        "rates": {p: dict(zip(names, map(told, rates), strict=True)) for p, rates in results.rates.items()},
        "pairs": {"both": both, "direct_only": direct, "robust_only": robust, "neither": neither},
        "mcnemar_exact_p": results.p_value,
        "difference": results.difference,
        "difference_95_over_threads": results.over_threads,
        "causes": results.causes,
        "mean_execution_s": results.execution_s,
        "repeated": results.repeats,
        "sessions": journal.sessions,
        "attempts": [attempt.model_dump() for attempt in journal.attempts],
    }


def _kind(thread: str) -> tuple[str, str]:
    configuration, background, *_ = thread.split("/")
    return configuration, background


def _rates(attempts: tuple[Attempt, ...], policy: PolicyName, kinds: tuple[tuple[str, str], ...]) -> tuple[Rate, ...]:
    own = [a for a in attempts if a.trial.policy == policy]
    each = [_rate([a for a in own if _kind(a.trial.thread) == kind], published_rate(policy, *kind)) for kind in kinds]
    return (*each, _rate(own, TOTALS[policy]))


def _rate(attempts: list[Attempt], published: float | None) -> Rate:
    outcomes = Counter(a.outcome for a in attempts)
    return Rate(outcomes["held"], outcomes["held"] + outcomes["failed"], outcomes["declined"], published)


def _counts(attempts: tuple[Attempt, ...], thread: str) -> list[int]:
    """Successes and trials of direct, then of robust, on a thread."""
    rates = [_rate([a for a in attempts if (a.trial.thread, a.trial.policy) == (thread, p)], None) for p in POLICIES]
    return [count for rate in rates for count in (rate.held, rate.tried)]


def _pairs(attempts: tuple[Attempt, ...]) -> tuple[int, int, int, int]:
    came: dict[tuple[str, int], dict[str, bool]] = {}
    for a in attempts:
        if a.outcome != "declined":
            came.setdefault((a.trial.thread, a.trial.goal), {})[a.trial.policy] = a.outcome == "held"
    seen = Counter((pair[DIRECT], pair[ROBUST]) for pair in came.values() if len(pair) == len(POLICIES))
    return seen[True, True], seen[True, False], seen[False, True], seen[False, False]


def _causes(attempts: tuple[Attempt, ...], policy: PolicyName) -> dict[str, int]:
    return dict(Counter(a.cause for a in attempts if a.trial.policy == policy and a.outcome == "failed").most_common())


def _mean_execution_s(attempts: tuple[Attempt, ...], policy: PolicyName) -> float | None:
    took = [a.execution_s for a in attempts if a.trial.policy == policy and a.execution_s is not None]
    return float(np.mean(took)) if took else None
