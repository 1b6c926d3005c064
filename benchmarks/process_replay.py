"""How long it takes to replay recordings through agents in process, beside what their steps take.

python -m benchmarks.process_replay sessions/*/session.mcap
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute import UnusableError, replayed
from benchmarks.measures import Goal

CHAINS = ("perception", "reconstruction", "planner", "perception,reconstruction,planner")
MOST_TIMES = 1.1
GOLDENS = Path("tests/goldens")


@dataclass(frozen=True)
class Options:
    """Which recordings; without any, the golden ones, which are small."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    json: Path | None = None


def main() -> None:
    """Replay each recording through each chain, print a table, and write JSON where asked to."""
    options = tyro.cli(Options)
    rows: list[dict[str, Any]] = []
    for path in options.recordings or sorted(GOLDENS.glob("*.mcap")):
        for chain in CHAINS:
            try:
                rows.append(_row(path, chain))
            except UnusableError as error:
                print(f"{path} through {chain}: {error}")
    print_table(rows)
    for goal in replay_goals(rows):
        print(f"{goal.what}: {goal.figure}, goal {goal.goal}: {'met' if goal.met else 'missed'}")
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def _row(path: Path, chain: str) -> dict[str, Any]:
    result = replayed(Recompute(path, through=chain, tolerances="table"))
    times = [entry.received_ns for entry in result.before]
    return {
        "recording": str(path),
        "chain": chain,
        "recorded s": 1e-9 * (times[-1] - times[0]),
        "messages": len(times),
        "outputs": sum(len(outcome.outputs) for outcome in result.outcomes),
        "repeated": sum(len(outcome.compared) for outcome in result.outcomes),
        "same": sum(output.same for outcome in result.outcomes for output in outcome.compared),
        "steps s": result.step_s,
        "wall s": result.wall_s,
        "times": result.wall_s / result.step_s if result.step_s else float("inf"),
    }


def replay_goals(rows: list[dict[str, Any]]) -> list[Goal]:
    """The row of the table of goals: all messages through all agents, over all recordings."""
    whole = [row for row in rows if row["chain"] == CHAINS[-1]]
    times = sum(row["wall s"] for row in whole) / sum(row["steps s"] for row in whole)
    what = "time: a replay through perception, reconstruction and planner, as a multiple of its steps"
    return [Goal(what, "-", f"≤ {MOST_TIMES:g}", f"{times:.2f}", times <= MOST_TIMES)]


def print_table(rows: list[dict[str, Any]]) -> None:
    """A row for each recording and chain."""
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*(f"{value:.2f}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
