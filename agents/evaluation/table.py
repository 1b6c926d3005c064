"""The results as Markdown: Table I with the paper's rows beside ours, and what the figures are worth."""

from agents.evaluation.results import Compared, Durations, Rate, Results, Row
from shared.success_rates import Interval


def page(results: Results) -> str:
    """Table and sentences for one size of the tool's error."""
    told = (*_compared(results), *_causes(results), *_durations(results), *_declined(results))
    return "\n".join([*table(results), "", *(f"- {sentence}" for sentence in told)]) + "\n"


def table(results: Results) -> list[str]:
    """Table I, a row for each method and policy."""
    columns = [name.replace("/", " ") for name in results.scenarios] + ["total", "95 % over threads"]
    lines = [f"| method, policy | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}"]
    for policy, rates in results.published.items():
        told = ("-" if rate is None else f"{rate:g} %" for rate in rates)
        lines.append(f"| published, {policy} | {' | '.join(told)} | - |")
    for row in results.rows:
        rates = results.rates[row]
        lines.append(f"| {named(row)} | {' | '.join(map(shown, rates))} | {between(rates[-1].over_threads)} |")
    return lines


def named(row: Row) -> str:
    """A row's name."""
    return f"{row[0]}, {row[1]}"


def shown(rate: Rate) -> str:
    """A rate with its counts."""
    return "-" if rate.share is None else f"{100 * rate.share:.1f} % ({rate.held}/{rate.tried})"


def between(interval: Interval | None, signed: bool = False) -> str:
    """An interval in percent."""
    if interval is None:
        return "-"
    sign = "+" if signed else ""
    return f"{100 * interval.low:{sign}.1f} to {100 * interval.high:{sign}.1f} %"


def _compared(results: Results) -> list[str]:
    return [_comparison(compared) for compared in results.compared if sum(compared.pairs)]


def _comparison(compared: Compared) -> str:
    both, first, second, neither = compared.pairs
    a, b = named(compared.first), named(compared.second)
    pairs = f"both held {both}, the former alone {first}, the latter alone {second}, neither {neither}"
    p = "the two never differed" if compared.p_value is None else f"McNemar p = {compared.p_value:.2g}"
    gain = f"{100 * (compared.difference or 0.0):+.1f} %"
    drawn = "" if compared.over_threads is None else f", 95 % over threads {between(compared.over_threads, True)}"
    return f"`{b}` less `{a}`: {gain}{drawn}; of {sum(compared.pairs)} goals {pairs}; {p}."


def _causes(results: Results) -> list[str]:
    return [
        f"Why `{named(row)}` failed: {', '.join(f'{code} {count}' for code, count in causes.items())}."
        for row, causes in results.causes.items()
        if causes
    ]


def _durations(results: Results) -> list[str]:
    return [_duration(row, took) for row, took in results.durations.items() if took is not None]


def _duration(row: Row, took: Durations) -> str:
    least = f"{took.least_s:.1f} s that the speed limits alone ask for"
    return f"`{named(row)}` took {took.took_s:.1f} s on average, {took.ratio:.2f} times the {least}."


def _declined(results: Results) -> list[str]:
    told: list[str] = []
    for row in results.rows:
        total = results.rates[row][-1]
        if total.declined and total.asked is not None:
            codes = ", ".join(f"{code} {count}" for code, count in results.declined[row].items())
            told.append(
                f"`{named(row)}` declined {total.declined} goals before anything moved ({codes}), which are in no "
                f"rate; were they failures, {100 * total.asked:.1f} % held."
            )
    return told
