"""Agents as processes of their own, on this host or on several, heard from beside."""

import collections
import contextlib
import os
import subprocess
import sys
import types

import pytest

from agents.cli.lab.rehearsal.network import CannotError
from agents.configuration.rig import (
    ArmSection,
    CameraSection,
    RigConfig,
    RouterSection,
    SimulatorSection,
    simulated_rig,
)
from agents.launch.supervisor import SUPERVISED
from schemas.codec import decode
from schemas.topics import COMMANDS, EXECUTION, HEALTH, LOG, OBSERVATIONS, PLAN, ROBOT_STATE, THREAD
from shared.runtime.connection import connected
from tests.command_words import words
from tests.rigs.faults.lab import laboratory

DEADLINE_S = 60.0
GOAL_DEADLINE_S = 120.0
"""Until a goal gets its plan: what is busy starting refuses for a while."""
HEARD = (HEALTH, LOG, OBSERVATIONS, THREAD, PLAN, EXECUTION, ROBOT_STATE, COMMANDS)


def small_rig(endpoint: str) -> RigConfig:
    """The simulated rig with a router elsewhere, few enough frames for two cores, and plans that may wait."""
    sections = {
        "router": RouterSection(endpoint=endpoint, start=False),
        "camera": CameraSection(rate_hz=5.0),
        "robot": {"psm1": ArmSection(maximum_plan_age_s=DEADLINE_S)},
        "simulator": SimulatorSection(config="easy", background="plain"),
    }
    return simulated_rig().model_copy(update=sections)


class Processes:
    """The processes of a test; those that still run are stopped at its end, or when the process of the tests ends."""

    def __init__(self, folder):
        self._folder = folder
        self.config = folder / "rig.json"
        self._running = {}

    def start(self, name, *arguments):
        """Start `suturegrasp NAME ...`."""
        if name in self._running:
            self._end(self._running.pop(name))
        command = [sys.executable, "-m", "agents.cli", *words(name), *arguments, "--config", str(self.config)]
        with (self._folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=log, env={**os.environ, SUPERVISED: "1"}
            )
        self._running[name] = process
        return process

    def kill(self, name):
        """SIGKILL, which nothing in the process hears."""
        process = self._running.pop(name)
        ended = process.poll() is not None
        self._end(process)
        assert not ended, f"{name} had ended before: {self.said(name)}"

    def said(self, name):
        """What a process printed."""
        return (self._folder / f"{name}.log").read_text()

    def ended(self):
        """Which processes have ended by themselves."""
        return {name: self.said(name) for name, process in self._running.items() if process.poll() is not None}

    def close(self):
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(5.0)
            self._end(process)

    def _end(self, process):
        process.kill()
        process.wait(DEADLINE_S)
        process.stdin.close()


class Ear:
    """What is published on a rig."""

    def __init__(self, connection):
        self.connection = connection
        self._heard = collections.defaultdict(list)
        self._read = collections.defaultdict(list)

    def hear(self, tapped):
        self._heard[tapped.topic].append(tapped.payload)

    def messages(self, topic):
        """All so far, in their order; each is decoded once."""
        read = self._read[topic]
        read += [decode(topic.message, payload) for payload in self._heard[topic][len(read) :]]
        return list(read)

    def health(self):
        """The newest health by kind."""
        return {health.agent: health for health in self.messages(HEALTH)}


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    with contextlib.closing(Processes(tmp_path_factory.mktemp("processes"))) as started:
        yield started


@pytest.fixture(scope="module")
def listening():
    """An ear on a rig, until the end of the module."""
    with contextlib.ExitStack() as stack:

        def listen(rig):
            ear = Ear(stack.enter_context(connected(rig.session, within_s=DEADLINE_S)))
            ear.connection.listen(HEARD, ear.hear)
            return ear

        yield listen


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A rig on four hosts and a router, once a thread was seen; left out where this system cannot play it."""
    try:
        with laboratory(tmp_path_factory.mktemp("lab"), emulated=True) as started:
            yield started
    except CannotError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def hosts():
    """What tests of this folder share besides fixtures."""
    return types.SimpleNamespace(small_rig=small_rig, DEADLINE_S=DEADLINE_S, GOAL_DEADLINE_S=GOAL_DEADLINE_S)
