"""The results as Markdown: Table I with the paper's rows beside ours, and what the figures are worth: among them
success over the size of the tool's error, and the least time that a plan's way takes at the limits of speed, were there
none of acceleration and jerk.

From one pose to the next the tool needs max(|Δp| / v, |Δangle| / ω, |Δjaw| / j); where there may be thread between the
fingers, v, ω and j are those of contact.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from agents.simulated_trials.protocol import Protocol
from agents.simulated_trials.results import Compared, Durations, Rate, Results, Row
from shared.rigid_transforms import angle_between
from shared.success_rates import Interval

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


def page(results: Results) -> str:
    """Table and sentences for one size of the tool's error."""
    told = (*_compared(results), *_causes(results), *_durations(results), *_checks(results), *_declined(results))
    return "\n".join([*table(results), "", *(f"- {sentence}" for sentence in told)]) + "\n"


def overview(protocol: Protocol, every: Sequence[Results], whole: Results) -> str:
    """Everything: a page for each size of the tool's error, the sweep over them, and how far promises hold."""
    lines = [*what_was_tried(protocol), ""]
    for results in every:
        lines += [f"## Tool error of {results.tool_error_mm:g} mm", "", page(results)]
    lines += sweep_table(sweeps(every)) + reliability_table(whole)
    return "\n".join(lines)


def sweep_table(found: Sequence[Sweep]) -> list[str]:
    """Rates over the tool's error; nothing where one size was tried."""
    if not found:
        return []
    columns = [f"{error:g} mm" for error in found[0].errors_mm]
    lines = ["## Over the tool's error", "", f"| method, policy | {' | '.join(columns)} | falls to 95 % at |"]
    lines.append(f"|---|{'---|' * (len(columns) + 1)}")
    for sweep in found:
        falls = "-" if sweep.falls_at_mm is None else f"{sweep.falls_at_mm:.2f} mm"
        lines.append(f"| {named(sweep.row)} | {' | '.join(map(shown, sweep.rates))} | {falls} |")
    return [*lines, ""]


def reliability_table(results: Results) -> list[str]:
    """How often promises came true, for each row."""
    lines = ["## Promised and held", ""]
    for row, found in results.reliability.items():
        if found is None:
            continue
        skill = "-" if found.skill is None else f"{found.skill:.2f}"
        lines += [
            f"`{named(row)}`: Brier score {found.brier:.4f}, skill {skill} against the base rate, "
            f"{found.trials} trials.",
            "",
            "| promised | trials | mean promise | held | off |",
            "|---|---|---|---|---|",
            *(
                f"| {b.low:g} to {b.high:g} | {b.trials} | {100 * b.promised:.1f} % | {100 * b.held:.1f} % | "
                f"{100 * b.off:+.1f} % |"
                for b in found.bins
            ),
            "",
        ]
    return lines


def what_was_tried(protocol: Protocol) -> list[str]:
    """The protocol in sentences."""
    images = "path-traced images" if protocol.images == "traced" else "images of the light renderer"
    errors = (
        f"tool tip {', '.join(f'{e:g}' for e in protocol.tool_errors_mm)} mm on each axis, registration up to "
        f"{protocol.hand_eye_mm:g} mm and {protocol.hand_eye_deg:g} degrees"
    )
    lines = [
        f"{len(protocol.scenarios)} scenarios, {protocol.threads} threads of each, {protocol.goals} goals on each, "
        f"seed {protocol.seed}; {images}; grasps judged by {protocol.judge} means; errors: {errors}."
    ]
    if protocol.injected_share:
        lines.append(
            f"Of {100 * protocol.injected_share:g} % of the goals the reconstructed thread was moved as a whole by up "
            f"to {protocol.injected_mm:g} mm."
        )
    if protocol.attempts > 1:
        lines.append(f"Up to {protocol.attempts} attempts at each goal.")
    if protocol.tissue:
        lines.append("The planner is told of the tissue.")
    if protocol.instrument:
        lines.append("Looks after a grasp show the instrument.")
    return lines


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
    pairs = f"both held {both}, `{a}` alone {first}, `{b}` alone {second}, neither {neither}"
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


def _checks(results: Results) -> list[str]:
    told: list[str] = []
    for row, checks in results.checks.items():
        if checks is None:
            continue
        said = ", ".join(f"{verdict} {count}" for verdict, count in checks.said.items())
        took = ", ".join(f"{attempts}: {count}" for attempts, count in checks.attempts.items())
        share = 100 * checks.falsely_held / sum(checks.said.values())
        told.append(
            f"Checks of `{named(row)}` said {said}; falsely held {checks.falsely_held} ({share:.2f} % of checks), "
            f"falsely missed {checks.falsely_missed}. Goals by attempts: {took}."
        )
    return told


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


@dataclass(frozen=True)
class SpeedLimits:
    """Of an arm: m/s, rad/s, rad/s of the jaw, and the share of them in contact."""

    speed: float
    angular_speed: float
    jaw_speed: float
    contact_share: float


def least_time_s(
    T_tool: Float64[np.ndarray, "n 4 4"],
    jaw_rad: Float64[np.ndarray, "n"],
    in_contact: Bool[np.ndarray, "n"],
    limits: SpeedLimits,
) -> float:
    """Through all poses, in one frame; `in_contact` tells of the way to each pose."""
    distance = np.linalg.norm(np.diff(T_tool[:, :3, 3], axis=0), axis=1)
    turn = angle_between(T_tool[:-1, :3, :3], T_tool[1:, :3, :3])
    # the jaws are the same after half a turn about the fingers
    turned = T_tool[1:, :3, :3] * np.array((-1.0, -1.0, 1.0))
    turn = np.minimum(turn, angle_between(T_tool[:-1, :3, :3], turned))
    jaw = np.abs(np.diff(jaw_rad))
    steps = np.max((distance / limits.speed, turn / limits.angular_speed, jaw / limits.jaw_speed), axis=0)
    return float((steps / np.where(in_contact[1:], limits.contact_share, 1.0)).sum())
