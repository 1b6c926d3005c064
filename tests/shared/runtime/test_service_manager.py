"""What a process tells the service manager that started it: a real socket, and a real process."""

import contextlib
import os
import socket
import subprocess
import sys
import textwrap

import pytest

from shared.runtime.service_manager import ServiceManager

AGENT = """
import signal, sys, threading
from shared.runtime.runner import Runner
from shared.runtime.session import SessionSettings, open_session

class Agent:
    kind, instance, inputs, outputs, commands, tick_hz = "planner", "main", (), (), (), 20.0
    ticks = 0

    def step(self, arrived):
        self.ticks += 1
        if sys.argv[2] == "hangs" and self.ticks > 20:
            threading.Event().wait()
        return ()

with open_session(SessionSettings("test", sys.argv[1])) as session:
    runner = Runner(Agent(), session, "test")
    signal.signal(signal.SIGTERM, lambda *_: runner.stop())
    runner.run()
"""


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A socket that listens as systemd's does, and what the environment says of it."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@suturegrasp-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0{name[1:]}" if name.startswith("@") else name)
        listener.settimeout(60.0)
        yield listener, {"NOTIFY_SOCKET": name}


@contextlib.contextmanager
def process(endpoint, environment, does="goes on"):
    command = [sys.executable, "-c", textwrap.dedent(AGENT), endpoint, does]
    started = subprocess.Popen(command, env=os.environ | environment)
    try:
        yield started
    finally:
        started.kill()
        started.wait(60.0)


def heard(listener):
    return listener.recv(4096).decode()


def test_a_process_says_that_it_is_ready_alive_and_stopping(manager, settings):
    listener, environment = manager
    with process(settings.endpoint, environment | {"WATCHDOG_USEC": "500000"}) as agent:
        said = [heard(listener)]
        while said.count("WATCHDOG=1") < 3:
            said.append(heard(listener))
        agent.terminate()
        while said[-1] != "STOPPING=1":
            said.append(heard(listener))
        assert agent.wait(60.0) == 0
    assert said[0] == "READY=1"
    assert "STATUS=running" in said
    assert set(said) == {"READY=1", "WATCHDOG=1", "STATUS=running", "STOPPING=1"}


def test_a_step_that_hangs_is_heard_of_no_more(manager, settings):
    listener, environment = manager
    with process(settings.endpoint, environment | {"WATCHDOG_USEC": "200000"}, "hangs") as agent:
        while heard(listener) != "WATCHDOG=1":
            pass
        listener.settimeout(1.5)
        with pytest.raises(TimeoutError):
            while True:
                heard(listener)
        assert agent.poll() is None


def told(manager, **more):
    listener, environment = manager
    one = ServiceManager(environment | more)
    for _ in range(3):
        one.alive()
    one.status("two\nlines")
    one.status("two\nlines")
    one.stopping()
    said = [heard(listener)]
    while said[-1] != "STOPPING=1":
        said.append(heard(listener))
    return said


@pytest.mark.parametrize(
    ("asked", "alive"),
    [
        ({"WATCHDOG_USEC": "60000000"}, ["WATCHDOG=1"]),
        ({"WATCHDOG_USEC": "60000000", "WATCHDOG_PID": str(os.getpid())}, ["WATCHDOG=1"]),
        ({"WATCHDOG_USEC": "60000000", "WATCHDOG_PID": "1"}, []),
        ({"WATCHDOG_USEC": "0"}, []),
        ({"WATCHDOG_USEC": "soon"}, []),
        ({}, []),
    ],
)
def test_who_is_not_watched_says_nothing_of_it_and_a_status_is_one_line_said_once(manager, asked, alive):
    assert told(manager, **asked) == [*alive, "STATUS=two lines", "STOPPING=1"]


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "/nobody/listens"}])
def test_without_a_manager_nobody_is_told_and_nothing_fails(environment):
    one = ServiceManager(environment | {"WATCHDOG_USEC": "1000000"})
    one.ready()
    one.alive()
    one.status("well")
    one.stopping()
    assert (one.alive_every_s is None) == (environment.get("NOTIFY_SOCKET", "") == "")


def test_a_process_is_alive_more_than_twice_in_each_period():
    one = ServiceManager({"NOTIFY_SOCKET": "/nobody/listens", "WATCHDOG_USEC": "2000000"})
    assert one.alive_every_s is not None
    assert 0 < one.alive_every_s < 1.0
