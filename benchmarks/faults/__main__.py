"""Every fault in the middle of a grasp, on four hosts and a router: what the arm did, what came back, what was lost.

    python -m benchmarks.faults [--only PATTERN] [--json out/faults.json]

Hosts are network namespaces of this machine; root and the commands ip, tc and nft are needed, and libfaketime for
clocks. Recovery counts from the end of the fault, or from when what was started again was ready, until threads,
states of the arm and plans flow. Events are those of all agents, heard at the switch, and those of a probe on each
host, which says 20 a second and hears all others.
"""

import json
import re
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro
from rich.console import Console

from agents.cli.lab.rehearsal.network import CannotError
from benchmarks.faults.table import table_of
from tests.rigs.faults.faults import Fault, all_faults
from tests.rigs.faults.lab import NotReachedError, laboratory
from tests.rigs.faults.recorded import missing_events
from tests.rigs.faults.trial import Seen, trial


@dataclass(frozen=True)
class Options:
    """Which faults, and how fast the camera is."""

    only: str = ""
    """Those whose name this pattern is found in."""
    rate_hz: float = 5.0
    json: Path | None = None
    logs: Path | None = None
    """A new folder for what the processes printed."""


def main() -> None:
    """Let everything fail in turn, print a table, and write JSON where asked to."""
    options = tyro.cli(Options)
    if options.logs is not None and options.logs.exists():
        raise SystemExit(f"{options.logs} is there already; name a new folder for the logs")
    chosen = [fault for fault in all_faults() if re.search(options.only, fault.name)]
    console, seen = Console(width=200), list[Seen]()
    for clocks in (False, True):
        of_kind = [fault for fault in chosen if fault.wants_clocks is clocks]
        for one in _tried(of_kind, clocks, options, console) if of_kind else ():
            seen.append(one)
    console.print(table_of(seen, chosen))
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps([asdict(one) for one in seen], indent=1) + "\n")


def _tried(faults: list[Fault], clocks: bool, options: Options, console: Console) -> Iterator[Seen]:
    """What each fault did, one after another in one lab."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.logs or Path(scratch)
        folder = folder / ("clocks" if clocks else "others")
        folder.mkdir(parents=True)
        try:
            with laboratory(folder, options.rate_hz, clocks) as lab:
                for fault in faults:
                    try:
                        seen = trial(lab, fault)
                    except NotReachedError as error:
                        seen = Seen(fault.name, ended=f"not tried: {error}")
                    console.print(f"{fault.name}: {seen.ended}, {seen.recovery_s}, lost {seen.lost}")
                    for at_s, sentence in seen.said:
                        console.print(f"  {at_s:6.2f} s  {sentence}", highlight=False, soft_wrap=True)
                    yield seen
                heard, missing = missing_events(lab)
                console.print(f"recordings: of {heard} events {sum(missing.values())} are missing {missing or ''}")
        except CannotError as error:
            console.print(f"left out: {', '.join(fault.name for fault in faults)}: {error}")


if __name__ == "__main__":
    main()
