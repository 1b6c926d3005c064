"""`suturegrasp up`: the router and the configured agents of this machine as processes, watched until Ctrl-C."""

import contextlib
import sys
import threading
from collections.abc import Generator, Mapping
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.text import Text

from agents.cli.live.options import Up
from agents.configuration.reading_session import reading_session
from agents.configuration.rig import RigConfig
from agents.diagnostics.status.gathered import expected_rates
from agents.diagnostics.status.health_watch import HealthWatch, name_of
from agents.diagnostics.status.report import watched
from agents.launch.preflight import already_running, in_the_way
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE, stopping
from agents.launch.session_folder import SessionFolder, new_session_folder
from agents.launch.supervisor import Change, Role, Supervisor, last_line, supervised
from schemas.topics import MAIN
from shared.runtime.connection import connected
from shared.terminal import UsageError, complain, say

EXIT_ALL_ENDED = 1
RECORDER = "recorder"
NO_RECORDER = "this host has no certificate of a recorder: put recorder into its runs"
LOOK_S = 0.5
FIRST_CONTACT_S = 30.0
"""How long a router may take to answer that is being started, on a busy machine."""


def start_all(supervisor: Supervisor, rig: RigConfig, config: Path, folder: SessionFolder, show: str) -> None:
    """Start every process of this machine; what records and shows comes first, so that it misses nothing."""

    def start(name: str, role: Role, *arguments: str) -> None:
        supervisor.add(name, [*arguments, "--config", str(config)], folder.log(name), role)

    if rig.runs_here("router"):
        start("router", Role.ROUTER, "router")
    if rig.runs_here(RECORDER):
        start(RECORDER, Role.RECORDER, "record", "--output", str(folder.recording), "--numbered")
    if rig.runs_here("viewer"):
        start("viewer", Role.VIEWER, "view", "--output", str(folder.rerun), "--numbered", "--show", show)
    for kind, instance in rig.agents_here():
        extra = ("--arm", instance) if instance != MAIN else ()
        start(name_of(kind, instance), Role.AGENT, "run", kind.replace("_", "-"), *extra)


@contextlib.contextmanager
def started(rig: RigConfig, restart: bool) -> Generator[Supervisor]:
    """Everything of this machine, with a folder of its session, for as long as it lasts.

    Raises:
        UsageError: where something is in its way.
    """
    if problem := in_the_way(rig) or already_running(rig):
        raise UsageError(problem)
    folder = new_session_folder(rig.sessions)
    config = folder.path / "rig.json"
    write_config(config, rig)
    with supervised(restart) as supervisor:
        start_all(supervisor, rig, config, folder, rig.viewer.show if rig.viewer is not None else "file")
        said = f"rig {rig.rig}: started {len(supervisor.children)} processes"
        say(f"{said}; {_kept_in(rig, folder.path)}; stop with Ctrl-C")
        yield supervisor
    say("every process was stopped")
    if rig.recorder is not None:
        say(last_line(folder.log(RECORDER)))


def start_recorder(supervisor: Supervisor, rig: RigConfig, folder: SessionFolder) -> bool:
    """Record beside a rig that runs; whether this host has the certificate for it."""
    identity = rig.identity_of(RECORDER)
    if identity is not None and not identity.certificate.exists():
        return False
    config = folder.path / "rig.json"
    write_config(config, rig)
    arguments = ["record", "--output", str(folder.recording), "--config", str(config)]
    supervisor.add(RECORDER, arguments, folder.log(RECORDER), Role.RECORDER)
    return True


def up(rig: RigConfig, options: Up) -> int:
    """Run until stopped; a live table on a terminal, lines elsewhere."""
    stopped = stopping()
    with (
        started(rig, options.restart) as supervisor,
        connected(reading_session(rig), FIRST_CONTACT_S, stopped) as connection,
    ):
        health = HealthWatch(connection, [name_of(kind, instance) for kind, instance in rig.agents_here()])
        return _watch(supervisor, health, expected_rates(rig), stopped)


def _kept_in(rig: RigConfig, folder: Path) -> str:
    """What of a session lies in its folder."""
    kept = {"recording (session.mcap)": rig.recorder, "what Rerun shows (session.rrd)": rig.viewer}
    told = [what for what, section in kept.items() if section is not None]
    return f"their {', '.join(['logs', *told[:-1]])}{f' and {told[-1]}' if told else ''} lie in {folder}"


def write_config(path: Path, rig: RigConfig) -> None:
    """Write the configuration that a session runs with, for its processes to read and for later."""
    path.write_text(rig.model_dump_json(indent=1, exclude_none=True) + "\n")


def _watch(supervisor: Supervisor, health: HealthWatch, rates_hz: Mapping[str, float], stopped: threading.Event) -> int:
    """Tell what happens, under a live table where there is a terminal, until stopped; the exit status."""
    on_terminal = sys.stdout.isatty()
    console = Console()
    with (
        Live(console=console, refresh_per_second=4, transient=True) if on_terminal else contextlib.nullcontext() as live
    ):
        while not stopped.wait(LOOK_S):
            changes = supervisor.watch()
            for line in (*(change.sentence for change in changes), *health.changes()):
                console.print(Text(line)) if live is not None else say(line)
            if over := _over(supervisor, changes):
                return complain(*over)
            if live is not None:
                live.update(watched(health.fares(), rates_hz))
    return EXIT_OK


def _over(supervisor: Supervisor, changes: list[Change]) -> tuple[str, int] | None:
    """Why there is nothing more to watch, and the exit status that goes with it."""
    for change in changes:
        if change.child.role is Role.ROUTER and change.status == EXIT_UNUSABLE:
            return "without its router nothing can run here", EXIT_UNUSABLE
    if not any(child.running or child.due_s is not None for child in supervisor.children if child.role is Role.AGENT):
        return "no agent runs any more", EXIT_ALL_ENDED
    return None
