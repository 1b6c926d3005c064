"""The results for programs."""

from typing import Any

from agents.evaluation.protocol import Protocol
from agents.evaluation.reliability import Reliability
from agents.evaluation.results import Compared, Rate, Results
from agents.evaluation.sweep import Sweep, sweeps
from agents.evaluation.table import named


def document(protocol: Protocol, every: list[Results], whole: Results) -> dict[str, Any]:
    """One entry for each size of the tool's error, and what is told of all of them."""
    return {
        "protocol": protocol.model_dump(),
        "results": [_told(results) for results in every],
        "sweep": [_sweep(sweep) for sweep in sweeps(every)],
        "reliability": {named(row): _reliability(found) for row, found in whole.reliability.items() if found},
    }


def _sweep(sweep: Sweep) -> dict[str, Any]:
    shares = [rate.share for rate in sweep.rates]
    told = {"row": named(sweep.row), "errors_mm": sweep.errors_mm, "shares": shares}
    return told | {"falls_to_95_percent_at_mm": sweep.falls_at_mm}


def _reliability(found: Reliability) -> dict[str, Any]:
    told = {"trials": found.trials, "brier": found.brier, "skill": found.skill, "worst_off": found.worst_off}
    return told | {"bins": [vars(b) for b in found.bins]}


def _told(results: Results) -> dict[str, Any]:
    names = [*results.scenarios, "total"]
    return {
        "tool_error_mm": results.tool_error_mm,
        "published_percent": {p: dict(zip(names, told, strict=True)) for p, told in results.published.items()},
        "rates": {named(row): dict(zip(names, map(_rate, rates), strict=True)) for row, rates in results.rates.items()},
        "compared": [_compared(compared) for compared in results.compared],
        "causes": {named(row): causes for row, causes in results.causes.items()},
        "declined": {named(row): codes for row, codes in results.declined.items()},
        "checks": {named(row): vars(checks) if checks else None for row, checks in results.checks.items()},
        "durations": {named(row): vars(took) if took else None for row, took in results.durations.items()},
    }


def _rate(rate: Rate) -> dict[str, Any]:
    told = {"held": rate.held, "tried": rate.tried, "declined": rate.declined, "share": rate.share}
    return told | {"95_over_threads": rate.over_threads, "95_wilson": rate.interval}


def _compared(compared: Compared) -> dict[str, Any]:
    both, first, second, neither = compared.pairs
    return {
        "first": named(compared.first),
        "second": named(compared.second),
        "pairs": {"both": both, "first_only": first, "second_only": second, "neither": neither},
        "difference": compared.difference,
        "difference_95_over_threads": compared.over_threads,
        "mcnemar_exact_p": compared.p_value,
    }
