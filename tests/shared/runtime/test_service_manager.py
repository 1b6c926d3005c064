"""What a process tells the service manager that started it, by a real socket."""

import os
import socket
import threading
from typing import Any

import pytest

from shared.runtime.agent import Agent
from shared.runtime.process import ServiceManager

DEADLINE_S = 60.0


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A socket that listens as systemd's does, and what the environment says of it."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@suturegrasp-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0{name[1:]}" if name.startswith("@") else name)
        listener.settimeout(DEADLINE_S)
        yield listener, {"NOTIFY_SOCKET": name}


class Hanging(Agent):
    """Ticks until it is told to hang."""

    kind, instance, inputs, outputs, commands, tick_hz = "planner", "main", (), (), (), 50.0

    def __init__(self):
        self.hangs, self.ended = threading.Event(), threading.Event()

    def step(self, arrived: Any):
        if self.hangs.is_set():
            self.ended.wait(DEADLINE_S)
        return ()


def heard(listener):
    return listener.recv(4096).decode()


@pytest.mark.parametrize("manager", ["path"], indirect=True)
def test_a_process_is_ready_then_alive_while_its_loop_turns_and_says_that_it_stops(manager, running, monkeypatch):
    listener, environment = manager
    for name, value in (environment | {"WATCHDOG_USEC": "100000"}).items():
        monkeypatch.setenv(name, value)
    agent = Hanging()
    runner = running(agent)
    said = [heard(listener)]
    assert said == ["READY=1"]
    while said.count("WATCHDOG=1") < 3 or "STATUS=running" not in said:
        said.append(heard(listener))
    agent.hangs.set()
    listener.settimeout(0.5)
    with pytest.raises(TimeoutError):
        while True:
            said.append(heard(listener))
    agent.hangs.clear()
    agent.ended.set()
    runner.stop()
    listener.settimeout(DEADLINE_S)
    while said[-1] != "STOPPING=1":
        said.append(heard(listener))
    assert set(said) == {"READY=1", "WATCHDOG=1", "STATUS=running", "STOPPING=1"}


@pytest.mark.parametrize(
    ("watched", "alive"),
    [
        ({"WATCHDOG_USEC": "60000000"}, ["WATCHDOG=1"]),
        ({"WATCHDOG_USEC": "60000000", "WATCHDOG_PID": str(os.getpid())}, ["WATCHDOG=1"]),
        ({"WATCHDOG_USEC": "60000000", "WATCHDOG_PID": "1"}, []),
        ({"WATCHDOG_USEC": "0"}, []),
        ({"WATCHDOG_USEC": "soon"}, []),
        ({}, []),
    ],
)
def test_who_is_not_watched_says_nothing_of_it_and_a_status_is_one_line_said_once(manager, watched, alive):
    listener, environment = manager
    one = ServiceManager(environment | watched)
    for _ in range(3):
        one.alive()
    for _ in range(2):
        one.status("two\nlines")
    one.stopping()
    assert [heard(listener) for _ in range(len(alive) + 2)] == [*alive, "STATUS=two lines", "STOPPING=1"]


@pytest.mark.parametrize(("name", "every_s"), [(None, None), ("", None), ("/nobody/listens", pytest.approx(0.8))])
def test_without_a_manager_nobody_is_told_and_nothing_fails(name, every_s):
    environment = {} if name is None else {"NOTIFY_SOCKET": name}
    one = ServiceManager(environment | {"WATCHDOG_USEC": "2000000"})
    one.ready()
    one.alive()
    one.status("well")
    one.stopping()
    # alive more than twice in each period
    assert one.alive_every_s == every_s
