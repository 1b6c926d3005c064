"""Starts the agents of this machine as processes, restarts what dies, and stops all of it in order."""

import contextlib
import enum
import os
import signal
import subprocess
import sys
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path

from shared.clock import monotonic_s

SUPERVISED = "SUTUREGRASP_SUPERVISED"
"""Environment variable of a process whose standard input ends with its supervisor."""
FIRST_BACKOFF_S, LONGEST_BACKOFF_S = 0.5, 10.0
STEADY_S = 10.0
"""A process that has run so long has earned a quick restart."""
STOP_LIMIT_S = 5.0
UNUSABLE = 2
"""The exit status of a process whose configuration is at fault, which a restart does not mend."""


class Role(enum.IntEnum):
    """What a process is for. They are stopped in this order, so that what records sees the others off."""

    AGENT = 0
    VIEWER = 1
    RECORDER = 2
    ROUTER = 3


@dataclass
class Child:
    """One process and how it fares.

    Fields:
        name: as people read it, such as `perception` or `robot_bridge psm1`.
        restarts: so far.
        backoff_s: how long the next restart will wait.
        due_s: when it is to be started again; None while it runs or is not to be restarted.
    """

    name: str
    arguments: list[str]
    log: Path
    role: Role = Role.AGENT
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    restarts: int = 0
    backoff_s: float = FIRST_BACKOFF_S
    due_s: float | None = None

    @property
    def running(self) -> bool:
        """Whether the process is there."""
        return self.process is not None and self.process.poll() is None


@dataclass(frozen=True)
class Change:
    """What has happened to a process, in plain words.

    Fields:
        final: whether it has ended and is not to be started again.
        status: with which it ended, negative for a signal; None for a start.
    """

    child: Child
    sentence: str
    final: bool = False
    status: int | None = None


@dataclass
class Supervisor:
    """The processes of this machine; `watch` is called again and again, and does not wait."""

    restart: bool = True
    program: tuple[str, ...] = (sys.executable, "-m", "agents.cli")
    children: list[Child] = field(default_factory=list[Child])
    # its other end is every process's standard input, which ends with us, even if we are killed
    _lifeline: tuple[int, int] = field(default_factory=os.pipe)

    def add(self, name: str, arguments: list[str], log: Path, role: Role = Role.AGENT) -> Child:
        """Start one more process; its output goes to that file."""
        child = Child(name, arguments, log, role)
        self.children.append(child)
        self._start(child)
        return child

    def watch(self) -> list[Change]:
        """Restart what is due, and tell what has happened since the last call."""
        changes: list[Change] = []
        for child in self.children:
            status = None if child.process is None else child.process.poll()
            if status is not None:
                changes.append(self._ended(child, status))
            elif child.due_s is not None and monotonic_s() >= child.due_s:
                child.restarts += 1
                self._start(child)
                changes.append(Change(child, f"{child.name} was started again (restart {child.restarts})"))
        return changes

    def stop(self) -> None:
        """Ask all to stop, one role after another, and kill what does not within a few seconds."""
        for role in Role:
            _stop([child for child in self.children if child.role is role])
        for end in self._lifeline:
            os.close(end)

    def _start(self, child: Child) -> None:
        with child.log.open("ab") as log:
            # a session of its own keeps the terminal's Ctrl-C from reaching it before all are stopped in order
            child.process = subprocess.Popen(
                [*self.program, *child.arguments],
                stdin=self._lifeline[0],
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={**os.environ, SUPERVISED: "1"},
            )
        child.started_s, child.due_s = monotonic_s(), None

    def _ended(self, child: Child, status: int) -> Change:
        child.process = None
        told = f"{child.name} {ending(status, child.log)}"
        if not self.restart or status == UNUSABLE:
            return Change(child, told, final=True, status=status)
        if monotonic_s() - child.started_s > STEADY_S:
            child.backoff_s = FIRST_BACKOFF_S
        wait_s, child.backoff_s = child.backoff_s, min(2 * child.backoff_s, LONGEST_BACKOFF_S)
        child.due_s = monotonic_s() + wait_s
        return Change(child, f"{told}; it starts again in {wait_s:.1f} s", status=status)


@contextlib.contextmanager
def supervised(restart: bool) -> Generator[Supervisor]:
    """A supervisor whose processes are stopped at the end, whatever happens."""
    supervisor = Supervisor(restart)
    try:
        yield supervisor
    finally:
        supervisor.stop()


def ending(status: int, log: Path) -> str:
    """How a process ended; where it had the chance to say why, in its own words."""
    if status < 0:
        return f"was ended by {signal.Signals(-status).name}"
    return f"ended with status {status}: {last_line(log)}"


def last_line(log: Path) -> str:
    """The last line of a log file, which is where a process says why it ended."""
    try:
        lines = log.read_text(errors="replace").strip().splitlines()
    except OSError:
        return f"see {log}"
    return lines[-1].removeprefix("suturegrasp: ") if lines else "it said nothing"


def _stop(children: list[Child]) -> None:
    for child in children:
        child.due_s = None
        if child.process is not None and child.running:
            child.process.terminate()
    deadline_s = monotonic_s() + STOP_LIMIT_S
    for child in children:
        if child.process is None:
            continue
        try:
            child.process.wait(max(0.1, deadline_s - monotonic_s()))
        except subprocess.TimeoutExpired:
            child.process.kill()
            child.process.wait()
