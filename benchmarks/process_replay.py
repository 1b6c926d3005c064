"""How long it takes to replay recordings through agents in process, beside what their steps take.

python -m benchmarks.process_replay sessions/*/session.mcap
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute import replayed
from benchmarks.tables import CONSOLE, Goal, Row, print_goals, print_rows, write_json
from shared.terminal import UsageError

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
    options = tyro.cli(Options, description=__doc__)
    rows: list[Row] = []
    for path in options.recordings or sorted(GOLDENS.glob("*.mcap")):
        for chain in CHAINS:
            try:
                rows.append(_row(path, chain))
            except UsageError as error:
                CONSOLE.print(f"{path} through {chain}: {error}")
    print_rows("replays", rows)
    whole = [row for row in rows if row["chain"] == CHAINS[-1]]
    if whole:
        times = sum(row["wall s"] for row in whole) / sum(row["steps s"] for row in whole)
        what = "time: a replay through perception, reconstruction and planner, as a multiple of its steps"
        print_goals("all recordings", [Goal(what, f"{times:.2f}", f"≤ {MOST_TIMES:g}", times <= MOST_TIMES)])
    write_json(options.json, rows)


def _row(path: Path, chain: str) -> Row:
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


if __name__ == "__main__":
    main()
