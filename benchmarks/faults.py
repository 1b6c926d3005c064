"""Every fault in the middle of a grasp, on four hosts and a router: what the arm did, what came back, what was lost.

    python -m benchmarks.faults [--only PATTERN] [--json out/faults.json]

Hosts are network namespaces of this machine; root and the commands ip, tc and nft are needed, and libfaketime for
clocks. Recovery counts from the end of the fault, or from when what was started again was ready, until threads,
states of the arm and plans flow. Events are those of all agents, heard at the switch, and those of a probe on each
host, which says 20 a second and hears all others.
"""

import re
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from agents.cli.lab.rehearsal.network import CannotError
from benchmarks.tables import CONSOLE, Row, print_rows, write_json
from tests.rigs.faults.faults import Fault, all_faults
from tests.rigs.faults.lab import NotReachedError, laboratory
from tests.rigs.faults.recorded import missing_events
from tests.rigs.faults.trial import Seen, trial

HOLDS_MS, RECOVERS_S = 250.0, 2.0


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
    options = tyro.cli(Options, description=__doc__)
    if options.logs is not None and options.logs.exists():
        raise SystemExit(f"{options.logs} is there already; name a new folder for the logs")
    chosen = [fault for fault in all_faults() if re.search(options.only, fault.name)]
    seen = list[Seen]()
    for clocks in (False, True):
        of_kind = [fault for fault in chosen if fault.wants_clocks is clocks]
        for one in _tried(of_kind, clocks, options) if of_kind else ():
            seen.append(one)
    by_name = {fault.name: fault for fault in chosen}
    goals = f"goals: holds within {HOLDS_MS:.0f} ms, recovers within {RECOVERS_S:g} s, loses no event"
    print_rows(goals, [row_of(one, by_name[one.fault]) for one in seen])
    write_json(options.json, [asdict(one) for one in seen])


def row_of(seen: Seen, fault: Fault) -> Row:
    """What a fault did; what misses a goal is red."""
    held = not fault.holds or (seen.held_ms is not None and seen.held_ms <= HOLDS_MS)
    recovered = bool(seen.recovery_s) and all(s is not None and s <= RECOVERS_S for s in seen.recovery_s.values())
    return {
        "fault": seen.fault,
        "grasp": seen.ended,
        "held after ms": _marked("-" if seen.held_ms is None else f"{seen.held_ms:.0f}", held),
        "start-up s": "-" if seen.startup_s is None else f"{seen.startup_s:.1f}",
        "recovery s": _marked(_recovery(seen), recovered),
        "events lost": _marked(str(sum(seen.lost.values())), not seen.lost),
        "named by": seen.name or ("nothing to name" if not seen.said else "[red]nobody[/]"),
    }


def _recovery(seen: Seen) -> str:
    """The slowest flow."""
    if not seen.recovery_s:
        return "-"
    name, slowest = max(seen.recovery_s.items(), key=lambda flow: float("inf") if flow[1] is None else flow[1])
    return f"{name} never" if slowest is None else f"{slowest:.1f}"


def _marked(text: str, good: bool) -> str:
    return text if good else f"[red]{text}[/]"


def _tried(faults: list[Fault], clocks: bool, options: Options) -> Iterator[Seen]:
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
                    CONSOLE.print(f"{fault.name}: {seen.ended}, {seen.recovery_s}, lost {seen.lost}")
                    for at_s, sentence in seen.said:
                        CONSOLE.print(f"  {at_s:6.2f} s  {sentence}", highlight=False, soft_wrap=True)
                    yield seen
                heard, missing = missing_events(lab)
                CONSOLE.print(f"recordings: of {heard} events {sum(missing.values())} are missing {missing or ''}")
        except CannotError as error:
            CONSOLE.print(f"left out: {', '.join(fault.name for fault in faults)}: {error}")


if __name__ == "__main__":
    main()
