"""What a session tells as one JSON document, for other programs. Units stand in the names; times are ns since 1970.

Tables in the terminal: as wide as it is; elsewhere, as in a pipe, plain lines that are never wrapped.
"""

import dataclasses
import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import rich.table
from rich.console import Console
from rich.text import Text

from agents.session_report.contents import KeyContents
from agents.session_report.grasps import Arming, Grasp
from agents.session_report.pulls import Pulled
from agents.session_report.session import Session
from agents.session_report.stages import BEFORE, PERCENTILES, StageTimes, added_ms, percentiles
from agents.session_report.table import Table, all_printable, first_rows
from schemas.messages import CommandAnswer, GraspGoal, GraspJudgement, GraspPlan, Tail
from shared.terminal import printable

FORM = 1
"""Counts up where a name changes its meaning."""


def document(session: Session) -> dict[str, Any]:
    """The whole of it, in values that JSON knows."""
    return {
        "form": FORM,
        "recording": str(session.path),
        "size_bytes": session.size_bytes,
        "finished": session.said.finished,
        "damage": session.damage or None,
        "complete": session.said.complete,
        "losses": session.said.lost,
        "derived": [dataclasses.asdict(one) for one in session.said.derived],
        "start_ns": session.start_ns,
        "duration_s": session.duration_s,
        "contents": [_contents(one) for one in session.contents],
        "stages": {name: _stage(session, name, times) for name, times in session.stages.items()},
        "agents": [dataclasses.asdict(one) for one in session.agents],
        "remarks": [dataclasses.asdict(one) for one in session.remarks],
        "results": {
            "count": dict(session.quality.results),
            "failed": [
                {"topic": topic, "reason": reason, "count": count}
                for (topic, reason), count in session.quality.failed.most_common()
            ],
            "track": dict(session.quality.steps),
        },
        "grasps": [_grasp(grasp) for grasp in session.grasps],
        "pulls": [_pull(pull) for pull in session.pulls],
        "other_commands": [
            {"at_ns": one.at_ns, "topic": one.topic, "answer": _answer(one.answer)} for one in session.other_commands
        ],
        "settings": [dataclasses.asdict(one) for one in session.settings],
        "facts": session.facts,
        "notes": [dataclasses.asdict(note) for note in session.notes],
    }


def _contents(one: KeyContents) -> dict[str, Any]:
    # when each message was received is the recording's to tell
    return {name: value for name, value in dataclasses.asdict(one).items() if name != "received_ns"}


def _stage(session: Session, name: str, times: StageTimes) -> dict[str, Any]:
    before = session.stages.get(BEFORE.get(name, ""))
    return {
        "count": len(times.captured),
        "rate_hz": times.rate_hz,
        "latency_ms": _named(percentiles(times.latency_ms)),
        "added_ms": _named(percentiles(added_ms(before, times))) if before else None,
    }


def _named(values: tuple[float, ...]) -> dict[str, float] | None:
    names = ["max" if p == 100 else f"p{p:.0f}" for p in PERCENTILES]
    return dict(zip(names, values, strict=True)) if values else None


def _grasp(grasp: Grasp) -> dict[str, Any]:
    return {
        "at_ns": grasp.at_ns,
        "outcome": grasp.outcome,
        "ended": grasp.ended,
        "goal": None if grasp.goal is None else _goal(grasp.goal),
        "answer": _answer(grasp.answer),
        "plan": None if grasp.plan is None else _plan(grasp.plan, grasp.plan_ns),
        "armings": [_arming(arming) for arming in grasp.armings],
    }


def _goal(goal: GraspGoal) -> dict[str, Any]:
    return {
        "id": goal.header.id,
        "sender": goal.header.sender,
        "arm": goal.arm,
        "policy": goal.policy.name.lower(),
        "s": goal.s,
        "pixel": None if goal.pixel is None else goal.pixel.tolist(),
        "point_camera_m": None if goal.point_camera is None else goal.point_camera.tolist(),
        "from_swage_m": goal.from_swage_m,
    }


def _pull(pull: Pulled) -> dict[str, Any]:
    return {
        "at_ns": pull.at_ns,
        "arm": pull.arm,
        "asked_m": pull.asked_m,
        "answer": _answer(pull.answer),
        "ended": pull.ended,
        "segments": list(pull.segments),
        "grasps": pull.grasps,
        "armings": [_arming(arming) for arming in pull.armings.values()],
        "tail": [_tail(captured_ns, tail) for captured_ns, tail in pull.tails],
    }


def _tail(captured_ns: int, tail: Tail) -> dict[str, Any]:
    assert tail.tail is not None  # noqa: S101 - those that were not measured are left out
    low_m, high_m = tail.tail.interval_m
    return {"captured_ns": captured_ns, "length_m": tail.tail.length_m, "low_m": low_m, "high_m": high_m}


def _answer(answer: CommandAnswer) -> dict[str, str]:
    return {"outcome": answer.outcome.name.lower(), "code": answer.code, "reason": answer.reason}


def _plan(plan: GraspPlan, published_ns: int | None) -> dict[str, Any]:
    return {
        "id": plan.plan_id,
        "published_ns": published_ns,
        "capture_left_ns": plan.stamp.capture_left_ns,
        "reason": plan.reason or None,
        "s_goal": plan.s_goal,
        "s_capture": plan.s_capture,
        "probability": plan.probability,
        "slide_m": plan.slide_m,
        "waypoints": len(plan.waypoints),
    }


def _arming(arming: Arming) -> dict[str, Any]:
    events = [
        {
            "at_ns": event.at_ns,
            "kind": event.kind.name.lower(),
            "phase": event.phase.name.lower() if event.phase else None,
            "code": event.code,
            "reason": event.reason,
        }
        for event in arming.events
    ]
    judgement = None if arming.judgement is None else _judgement(arming.judgement)
    answer = _answer(arming.answer)
    return {"id": arming.arming_id, "at_ns": arming.at_ns, "answer": answer, "events": events, "judgement": judgement}


def _judgement(judged: GraspJudgement) -> dict[str, Any]:
    return {
        "at_ns": judged.at_ns,
        "verdict": judged.verdict.name.lower(),
        "s_caught": judged.s_caught,
        "slid_m": judged.slid_m,
        "error_m": judged.error_m,
        "sentence": judged.sentence,
    }


def names_of(paths: list[Path]) -> list[str]:
    """A short name for each recording, by which it can be told from the others."""
    for name in (lambda path: path.name, lambda path: path.resolve().parent.name, str):
        names = [str(name(path)) for path in paths]
        if len(set(names)) == len(names):
            return names
    return [f"{number}: {path}" for number, path in enumerate(paths, 1)]


ROWS_SHOWN = 40
UNWRAPPED = 10_000


def lines(heads: Iterable[str], tables: Iterable[Table], width: int | None) -> Iterator[str]:
    """What to print: sentences, then tables; without a width nothing is wrapped, cut or coloured."""
    for head in heads:
        yield printable(head)
    for table in tables:
        yield ""
        yield from _table_lines(table, width)


def _table_lines(table: Table, width: int | None) -> Iterator[str]:
    shown, left = first_rows(table, ROWS_SHOWN)
    drawn = rich.table.Table(box=None, pad_edge=False, title=None, header_style="dim")
    for column in table.columns:
        is_figure = column.startswith(" ")
        drawn.add_column(Text(column.strip()), justify="right" if is_figure else "left", overflow="fold")
    for row in all_printable(shown):
        drawn.add_row(*(Text(cell) for cell in row))
    out = io.StringIO()
    console = Console(
        file=out,
        width=width or UNWRAPPED,
        force_terminal=width is not None,
        no_color=width is None,
        highlight=False,
        legacy_windows=False,
    )
    console.print(Text(table.title, style="bold"))
    console.print(drawn)
    yield from (line.rstrip() for line in out.getvalue().splitlines())
    if left:
        yield f"... and {left} more, which --json and --html show"
