"""Agents as processes of their own, on this host or in network namespaces, heard from beside."""

import dataclasses
import subprocess
import sys
import threading
import types

import pytest

from agents.cli.rig import CameraSection, RigConfig, RouterSection, SimulatorSection, simulated_rig
from schemas.codec import decode
from schemas.messages import AgentHealth
from schemas.topics import COMMANDS, EXECUTION, HEALTH, LOG, OBSERVATIONS, PLAN, ROBOT_STATE, THREAD
from shared.clock import monotonic_s
from shared.runtime.connection import connected
from shared.runtime.taps import Tapped

DEADLINE_S = 30.0
HEARD = (HEALTH, LOG, OBSERVATIONS, THREAD, PLAN, EXECUTION, ROBOT_STATE, COMMANDS)


def small_rig(endpoint: str) -> RigConfig:
    """The simulated rig with a router elsewhere, and few enough frames for two cores."""
    sections = {
        "router": RouterSection(endpoint=endpoint, start=False),
        "camera": CameraSection(rate_hz=5.0),
        "simulator": SimulatorSection(config="easy", background="plain"),
    }
    return simulated_rig().model_copy(update=sections)


def wait_for(condition, what):
    """The value of a condition once it is true; a failure that says what was waited for after the deadline."""
    deadline_s, turn = monotonic_s() + DEADLINE_S, threading.Event()
    while not (value := condition()):
        assert monotonic_s() < deadline_s, f"waited {DEADLINE_S:.0f} s for {what}"
        turn.wait(0.05)
    return value


class Processes:
    """The processes of a test; those that still run are killed at its end."""

    def __init__(self, folder):
        self._folder = folder
        self.config = folder / "rig.json"
        self._running = {}

    def start(self, name, *arguments, inside=()):
        """Start `suturegrasp NAME ...`; `inside` comes before it, as `ip netns exec` does."""
        command = [*inside, sys.executable, "-m", "agents.cli", name, *arguments, "--config", str(self.config)]
        with (self._folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        self._running[name] = process
        return process

    def kill(self, name):
        """SIGKILL, which nothing in the process hears."""
        process = self._running.pop(name)
        assert process.poll() is None, f"{name} had ended before: {self.said(name)}"
        process.kill()
        process.wait(DEADLINE_S)

    def said(self, name):
        """What a process printed."""
        return (self._folder / f"{name}.log").read_text()

    def ended(self):
        """Which processes have ended by themselves."""
        return {name: self.said(name) for name, process in self._running.items() if process.poll() is not None}

    def end(self):
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(DEADLINE_S)


@dataclasses.dataclass
class Ear:
    """What is published on a rig."""

    connection: object
    heard: list[Tapped]

    def of(self, topic):
        return [t for t in list(self.heard) if t.topic is topic]

    def messages(self, topic):
        return [decode(topic.message, t.payload) for t in self.of(topic)]

    def health(self):
        """The newest health by kind."""
        return {h.agent: h for h in (decode(AgentHealth, t.payload) for t in self.of(HEALTH))}


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    started = Processes(tmp_path_factory.mktemp("processes"))
    yield started
    started.end()


@pytest.fixture(scope="module")
def listening():
    """An ear on a rig, until the end of the module."""
    kept = []

    def listen(rig):
        context = connected(rig.session, within_s=DEADLINE_S)
        connection = context.__enter__()
        kept.append(context)
        ear = Ear(connection, [])
        connection.listen(HEARD, ear.heard.append)
        return ear

    yield listen
    for context in kept:
        context.__exit__(None, None, None)


@pytest.fixture(scope="session")
def hosts():
    """What tests of this folder share besides fixtures."""
    return types.SimpleNamespace(small_rig=small_rig, wait_for=wait_for, DEADLINE_S=DEADLINE_S)
