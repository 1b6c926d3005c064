"""What benchmarks share when they tell what they found: rows as tables, goals with their verdicts, and JSON."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

CONSOLE = Console(width=200)
Row = dict[str, Any]


@dataclass(frozen=True)
class Goal:
    """One row of a table of goals; `met` is None where nothing is aimed at.

    Fields:
        published: what others reach.
        bound: what the images allow on the same runs.
    """

    what: str
    figure: str
    goal: str = "-"
    met: bool | None = None
    published: str = "-"
    bound: str = ""


def print_rows(title: str, rows: Sequence[Mapping[str, object]]) -> None:
    """A table whose columns are the keys of its rows; nothing where there is no row."""
    if not rows:
        return
    table = Table(title=title, title_justify="left")
    for column, value in rows[0].items():
        table.add_column(column, justify="left" if isinstance(value, str) else "right")
    for row in rows:
        table.add_row(*map(shown, row.values()))
    CONSOLE.print(table)


def print_goals(title: str, goals: Iterable[Goal]) -> None:
    """What is aimed at, what came out, and whether that is met."""
    verdicts = {True: "[green]met[/]", False: "[red]not met[/]", None: ""}
    rows = [
        {
            "what": goal.what,
            "published by others": goal.published,
            "goal": goal.goal,
            "here": goal.figure,
            "": verdicts[goal.met],
            "bound": goal.bound,
        }
        for goal in goals
    ]
    told = [name for name in rows[0] if any(row[name] not in ("", "-") for row in rows)] if rows else []
    print_rows(title, [{name: row[name] for name in told} for row in rows])


def shown(value: object) -> str:
    """A value as tables print it."""
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return "-" if value is None else str(value)


def share(part: float, whole: float) -> str:
    """In per cent."""
    return f"{part / whole:.1%}" if whole else "-"


def write_json(path: Path | None, found: object) -> None:
    """Write everything that was found, where a path is given."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found, indent=1) + "\n")
