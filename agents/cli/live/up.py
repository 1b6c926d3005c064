"""`suturegrasp up`: the router and the configured agents of this machine as processes, watched until Ctrl-C."""

import contextlib
import sys
import threading
from collections.abc import Mapping
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
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE, on_stop
from agents.launch.session_folder import SessionFolder, new_session_folder
from agents.launch.supervisor import Change, Role, Supervisor, last_line, supervised
from schemas.topics import MAIN
from shared.runtime.connection import connected
from shared.terminal import complain, say

EXIT_ALL_ENDED = 1
LOOK_S = 0.5
FIRST_CONTACT_S = 30.0
"""How long a router may take to answer that is being started, on a busy machine."""


def start_all(supervisor: Supervisor, rig: RigConfig, config: Path, folder: SessionFolder, show: str) -> None:
    """Start every process of this machine; what records and shows comes first, so that it misses nothing."""

    def start(name: str, role: Role, *arguments: str) -> None:
        supervisor.add(name, [*arguments, "--config", str(config)], folder.log(name), role)

    if rig.runs_here("router"):
        start("router", Role.ROUTER, "router")
    if rig.runs_here("recorder"):
        start("recorder", Role.RECORDER, "record", "--output", str(folder.recording), "--numbered")
    if rig.runs_here("viewer"):
        start("viewer", Role.VIEWER, "view", "--output", str(folder.rerun), "--numbered", "--show", show)
    for kind, instance in rig.agents_here():
        extra = ("--arm", instance) if instance != MAIN else ()
        start(name_of(kind, instance), Role.AGENT, "run", kind.replace("_", "-"), *extra)


def up(rig: RigConfig, options: Up) -> int:
    """Run until stopped; a live table on a terminal, lines elsewhere."""
    if problem := in_the_way(rig) or already_running(rig):
        return complain(problem, EXIT_UNUSABLE)
    sessions = rig.recorder.folder if rig.recorder is not None else Path("sessions")
    try:
        folder = new_session_folder(sessions)
    except OSError as error:
        return complain(f"no session can be kept in {sessions}: {error.strerror}", EXIT_UNUSABLE)
    config = folder.path / "rig.json"
    write_config(config, rig)
    stopped = threading.Event()
    on_stop(stopped.set)
    show = rig.viewer.show if rig.viewer is not None else "file"
    with contextlib.ExitStack() as stack:
        supervisor = stack.enter_context(supervised(options.restart))
        start_all(supervisor, rig, config, folder, show)
        said = f"rig {rig.rig}: started {len(supervisor.children)} processes"
        say(f"{said}; {kept_in(rig, folder.path)}; stop with Ctrl-C")
        connection = stack.enter_context(connected(reading_session(rig), FIRST_CONTACT_S, stopped))
        expected = [name_of(kind, instance) for kind, instance in rig.agents_here()]
        status = _watch(supervisor, HealthWatch(connection, expected), expected_rates(rig), stopped)
    say("every process was stopped")
    if rig.recorder is not None:
        say(last_line(folder.log("recorder")))
    return status


def kept_in(rig: RigConfig, folder: Path) -> str:
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
