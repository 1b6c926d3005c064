"""Agents as processes of their own, on this host or on several, heard from beside; and containers."""

import contextlib
import subprocess
import threading

import pytest

from agents.cli.lab.rehearsal.network import CannotError
from agents.launch.supervisor import Role, supervised
from shared.runtime.connection import connected
from tests.command_words import words
from tests.rigs.faults.lab import laboratory
from tests.rigs.faults.observer import Observer

DEADLINE_S = 60.0
GOAL_DEADLINE_S = 120.0
"""Until a goal gets its plan: what is busy starting refuses for a while."""


class Processes:
    """The processes of a test, stopped at its end."""

    def __init__(self, folder, supervisor):
        self._folder, self._supervisor, self._running = folder, supervisor, {}
        self.config = folder / "rig.json"

    def start(self, name, *arguments):
        """Start `suturegrasp NAME ...`."""
        command = [*words(name), *arguments, "--config", str(self.config)]
        role = Role.ROUTER if name == "router" else Role.AGENT
        self._running[name] = self._supervisor.add(name, command, self._folder / f"{name}.log", role)
        return self._running[name].process

    def kill(self, name):
        """SIGKILL, which nothing in the process hears."""
        child = self._running.pop(name)
        assert child.running, f"{name} had ended before: {self.said(name)}"
        child.process.kill()
        child.process.wait(DEADLINE_S)

    def finished(self, name):
        """The exit status of a process that ends by itself."""
        return self._running.pop(name).process.wait(DEADLINE_S)

    def said(self, name):
        """What a process printed."""
        return (self._folder / f"{name}.log").read_text()

    def ended(self):
        """Which processes have ended by themselves."""
        return {name: self.said(name) for name, child in self._running.items() if not child.running}


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    with supervised(restart=False) as supervisor:
        yield Processes(tmp_path_factory.mktemp("processes"), supervisor)


@pytest.fixture(scope="module")
def listening():
    """An observer of a rig, until the end of the module."""
    with contextlib.ExitStack() as stack:

        def listen(rig):
            connection = stack.enter_context(connected(rig.session, within_s=DEADLINE_S))
            return stack.enter_context(contextlib.closing(Observer(connection)))

        yield listen


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A rig on four hosts and a router, once a thread was seen; left out where this system cannot play it."""
    try:
        with laboratory(tmp_path_factory.mktemp("lab"), emulated=True) as started:
            yield started
    except CannotError as error:
        pytest.skip(str(error))


@contextlib.contextmanager
def copy_of_this_machine(folder):
    """This machine's files below a folder; what is written to them goes to memory. Skips where that cannot be."""
    root, memory = folder / "root", folder / "memory"
    for part in (root, memory):
        part.mkdir(parents=True)
    try:
        _must("mount", "-t", "tmpfs", "none", memory)
        for part in ("upper", "work"):
            (memory / part).mkdir()
        layers = f"lowerdir=/,upperdir={memory / 'upper'},workdir={memory / 'work'}"
        _must("mount", "-t", "overlay", "overlay", "-o", layers, root)
        yield root
    finally:
        for _ in range(50):
            # what a container ran ends a moment later
            if _run("umount", "--recursive", root).returncode == 0:
                break
            threading.Event().wait(0.1)
        _run("umount", memory)


def _run(*command):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=60.0, check=False)


def _must(*command):
    done = _run(*command)
    if done.returncode != 0:
        pytest.skip(f"this system cannot play machines: {command[0]}: {done.stderr}")
