"""The results as a page of Markdown: Table I with the paper's row beside it, and what its figures are worth."""

from agents.experiment.journal import POLICIES, PolicyName
from agents.experiment.results import Rate, Results
from shared.success_rates import FEWEST_THREADS, Interval


def page(results: Results) -> str:
    """Markdown."""
    columns = [" ".join(kind) for kind in results.kinds] + ["total", "95 %"]
    lines = [f"| policy | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}"]
    for policy in POLICIES:
        rates = results.rates[policy]
        lines.append(f"| {policy} | {' | '.join(map(_shown, rates))} | {_interval(rates[-1].interval)} |")
    for policy in POLICIES:
        published = ("-" if r.published is None else f"{r.published:g} %" for r in results.rates[policy])
        lines.append(f"| {policy}, published | {' | '.join(published)} | - |")
    told = (*_declined(results), *_compared(results), *_failed(results), *_took(results))
    return "\n".join([*lines, "", *(f"- {sentence}" for sentence in told)]) + "\n"


def _shown(rate: Rate) -> str:
    return "-" if rate.percent is None else f"{rate.percent:.1f} % ({rate.held}/{rate.tried})"


def _interval(interval: Interval | None, signed: bool = False) -> str:
    if interval is None:
        return "-"
    sign = "+" if signed else ""
    return f"{100 * interval.low:{sign}.1f} to {100 * interval.high:{sign}.1f} %"


def _declined(results: Results) -> list[str]:
    counts = {policy: results.rates[policy][-1].declined for policy in POLICIES}
    if not any(counts.values()):
        return []
    told = " and ".join(f"{count} with {policy}" for policy, count in counts.items())
    totals = {policy: results.rates[policy][-1] for policy in POLICIES}
    asked = {policy: Rate(rate.held, rate.tried + rate.declined, 0, None) for policy, rate in totals.items()}
    failures = " and ".join(f"{_shown(rate)} with {policy}" for policy, rate in asked.items())
    return [f"Declined before anything moved, and in no rate: {told}. Were they failures: {failures}."]


def _compared(results: Results) -> list[str]:
    both, direct, robust, neither = results.pairs
    if not (total := sum(results.pairs)):
        return ["No goal was tried with both policies."]
    pairs = f"both {both}, direct alone {direct}, robust alone {robust}, neither {neither}"
    told = [f"Of {total} goals tried with both policies held: {pairs}."]
    if results.p_value is None:
        told.append("McNemar's test says nothing, for the policies never differed.")
    else:
        told.append(f"McNemar's exact test: p = {results.p_value:.3g}; it takes goals on one thread for independent.")
    if results.over_threads is None:
        told.append(f"How threads differ cannot be told from fewer than {FEWEST_THREADS}.")
    elif results.difference is not None:
        drawn = f"{_interval(results.over_threads, signed=True)}, drawing from {results.threads} threads anew"
        told.append(f"Robust less direct: {100 * results.difference:+.1f} %, 95 % {drawn}.")
    return told


def _failed(results: Results) -> list[str]:
    def causes(policy: PolicyName) -> str:
        return ", ".join(f"{cause} {count}" for cause, count in results.causes[policy].items())

    told = [f"{policy}: {causes(policy)}" for policy in POLICIES if results.causes[policy]]
    return [f"Why grasps failed: {'; '.join(told)}."] if told else []


def _took(results: Results) -> list[str]:
    took = {policy: mean_s for policy, mean_s in results.execution_s.items() if mean_s is not None}
    told = (
        [f"A grasp took {', '.join(f'{mean_s:.1f} s ({policy})' for policy, mean_s in took.items())}."] if took else []
    )
    if results.repeats:
        told.append(f"Begun again after an interruption or a hold: {results.repeats} times.")
    return told
