"""Sessions side by side: rates, latencies, outcomes, and what they were run with where that differs."""

from collections import Counter
from collections.abc import Callable, Iterable

from agents.session_report.session import Session
from agents.session_report.stages import percentiles
from agents.session_report.table import Row, Table, decimal, short

Value = float | None
OF_A_REPLAY = {
    "from capture until published, ms": "; of what a replay made, as recorded",
    "times of a step, ms": "; of agents that ran anew, in the replay",
    "what came of the grasps": "; a replayed planner's plans and promises, what an arm did as recorded",
}
"""What a title adds where a session was replayed: a replay publishes nothing, and no grasp comes of it."""


def comparison_tables(sessions: list[Session], names: list[str]) -> list[Table]:
    """Tables with a column for each session; of two, also the change from the first to the second."""
    figures: dict[str, Callable[[Session], dict[str, Value]]] = {
        "in all": _overall,
        "messages a second": _rates,
        "lost messages": lambda session: {short(one.key): one.lost or None for one in session.contents},
        "from capture until published, ms": _latencies,
        "times of a step, ms": _steps,
        "left out for newer ones": _dropped,
        "what became of the frames": _results,
        "what came of the grasps": _outcomes,
    }
    replayed = any(session.said.ran_anew for session in sessions)
    tables = [
        _table(title + (OF_A_REPLAY.get(title, "") if replayed else ""), [of(session) for session in sessions], names)
        for title, of in figures.items()
    ]
    return [table for table in (*tables, _differences(sessions, names)) if table.rows]


def _table(title: str, figures: list[dict[str, Value]], names: list[str]) -> Table:
    rows = [_row(name, [of.get(name) for of in figures]) for name in _union(figures)]
    change = (" change",) if len(names) == 2 else ()
    columns = ("", *(f" {name}" for name in names), *change)
    # what none of them has is no news
    return Table(title, columns, tuple(row for row in rows if any(cell not in ("", "-") for cell in row[1:])))


def _row(name: str, values: list[Value]) -> Row:
    change = (_change(*values),) if len(values) == 2 else ()
    return (name, *(_number(value) for value in values), *change)


def _number(value: Value) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else decimal(value)


def _change(before: Value, after: Value) -> str:
    if not before or after is None:
        return ""
    return f"{(after - before) / before:+.0%}"


def _union(figures: Iterable[dict[str, Value]]) -> list[str]:
    """All names in the order in which they first come."""
    return list(dict.fromkeys(name for of in figures for name in of))


def _overall(session: Session) -> dict[str, Value]:
    return {
        "duration, s": session.duration_s,
        "size, MB": session.size_bytes * 1e-6,
        "messages": sum(one.count for one in session.contents),
        "known to be lost": sum(one.lost for one in session.contents),
        "silences": sum(gap.lost == 0 for one in session.contents for gap in one.gaps),
        "unreadable": sum(one.unreadable for one in session.contents),
        "warnings, errors and faults": sum(one.count for one in session.remarks),
    }


def _rates(session: Session) -> dict[str, Value]:
    """Of what comes regularly; how often something was said or asked for is no rate."""
    return {short(one.key): one.rate_hz for one in session.contents if one.is_regular}


def _latencies(session: Session) -> dict[str, Value]:
    figures: dict[str, Value] = {}
    for name, times in session.stages.items():
        p50, _, p99, most = percentiles(times.latency_ms)
        figures |= {f"{name} p50": p50, f"{name} p99": p99, f"{name} max": most}
    return figures


def _steps(session: Session) -> dict[str, Value]:
    """Of the steps that made what the file holds: those of a replay, of an agent that ran anew.

    They are no figures of one kind: an agent counts all its steps, of which most may only remember what came, and a
    replay those that it repeats.
    """
    anew = {agent.replace("/", " "): one for agent, one in session.said.ran_anew.items()}
    figures: dict[str, Value] = {}
    for one in session.agents:
        if one.name not in anew:
            figures |= {f"{one.name} p50": one.step_ms_p50, f"{one.name} p99": one.step_ms_p99}
    for name, one in anew.items():
        figures |= {f"{name}, replayed p50": one.step_ms_p50, f"{name}, replayed p99": one.step_ms_p99}
    return figures


def _dropped(session: Session) -> dict[str, Value]:
    return {
        f"{one.topic} by {one.agent}": one.dropped for agent in session.agents for one in agent.drops if one.dropped
    }


def _results(session: Session) -> dict[str, Value]:
    quality = session.quality
    figures: dict[str, Value] = {f"{topic} results": count for topic, count in sorted(quality.results.items())}
    failed: Counter[str] = Counter()
    for (topic, _), count in quality.failed.items():
        failed[topic] += count
    figures |= {f"{topic} failed": count for topic, count in sorted(failed.items())}
    return figures | {f"track {step}": count for step, count in sorted(quality.steps.items())}


def _outcomes(session: Session) -> dict[str, Value]:
    plans = [grasp.plan for grasp in session.grasps if grasp.plan is not None and not grasp.plan_before]
    promised = [plan.probability for plan in plans if not plan.reason]
    told = {"mean promised success, %": 100 * sum(promised) / len(promised)} if promised else {}
    return {"goals": len(session.grasps), **told, **Counter(grasp.outcome for grasp in session.grasps)}


def _differences(sessions: list[Session], names: list[str]) -> Table:
    """Facts that are not the same in all sessions."""
    facts = [session.facts for session in sessions]
    rows = [(name, *(of.get(name, "-") for of in facts)) for name in dict.fromkeys(name for of in facts for name in of)]
    differing = (row for row in rows if len(set(row[1:])) > 1)
    return Table("run differently", ("", *names), tuple(differing))
