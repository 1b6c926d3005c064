"""Intruders on a secured rig: without certificate, with another agent's, and owners who send malformed messages.

    python -m tests.rigs.intruder.attacked [--messages 100000] [--json out/intruder.json]

Every agent and the recorder run as processes of their own behind a router with certificates and access rules, on one
host. Nothing of the first two may be delivered; of the third, each consumer's own account, and the recording, must
account for every message; every command must be answered; nothing may end or hang, and a goal must get its plan after
all of it.
"""

import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table

from tests.rigs.intruder.flood import flooded
from tests.rigs.intruder.links import refused_connections
from tests.rigs.intruder.rig import CannotError, secured_rig
from tests.rigs.intruder.rows import Row
from tests.rigs.intruder.rules import forged


@dataclass(frozen=True)
class Options:
    """How much of it.

    Fields:
        links: connections of each kind; the router tells the first, and each hundredth after it.
    """

    messages: int = 100_000
    links: int = 101
    seed: int = 1
    huge: bool = True
    """Whether one message of 40 MB and one of 256 MB are among them."""
    json: Path | None = None
    logs: Path | None = None
    """Where to keep what the processes printed, and the recording."""


def main() -> None:
    """Attack, print a table, and write JSON where asked to."""
    options = tyro.cli(Options)
    with tempfile.TemporaryDirectory() as scratch:
        try:
            rows, notes = attacked(options.logs or Path(scratch), options)
        except CannotError as error:
            raise SystemExit(f"nothing was tried: {error}") from None
    print_rows(rows, notes)
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps({"rows": [asdict(row) for row in rows], "notes": notes}, indent=1) + "\n")


def attacked(folder: Path, options: Options) -> tuple[list[Row], list[str]]:
    """What became of every attack, and what is worth knowing besides.

    Raises:
        CannotError: where this machine cannot play it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with secured_rig(folder, "camera", "perception", "reconstruction", "planner") as rig:
        rows = refused_connections(rig, options.links)
        rig.until_ready("camera", "perception", "reconstruction", "planner", "recorder")
        rows += forged(rig)
        more, notes = flooded(rig, options.messages, options.seed, options.huge)
    return rows + more, notes


def print_rows(rows: list[Row], notes: list[str]) -> None:
    """A row an attack; what misses the goal is red."""
    table = Table(title="nothing delivered that is not its sender's own, nothing crashed, each accounted for")
    for column in ("attack", "sent", "delivered", "refused", "dropped", "missed", "unaccounted", "crashed"):
        table.add_column(column, justify="left" if column == "attack" else "right")
    for row in rows:
        counts = [row.sent, row.delivered, row.refused, row.dropped, row.missed]
        shown = ["-" if count is None else str(count) for count in counts]
        left = "-" if row.unaccounted is None else str(row.unaccounted)
        colour = "" if row.good else "red"
        table.add_row(row.attack, *shown, left, str(row.crashed), style=colour)
    console = Console(width=140)
    console.print(table)
    for note in notes:
        console.print(note, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
