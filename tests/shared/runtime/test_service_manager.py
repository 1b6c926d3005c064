"""What a process tells the service manager that started it, by a real socket."""

import contextlib
import os
import socket
import threading
from typing import Any

import pytest

from shared.runtime.process import ServiceManager
from tests.shared.runtime.conftest import Idle

DEADLINE_S = 60.0
MINUTE = {"WATCHDOG_USEC": "60000000"}


@contextlib.contextmanager
def listening(name):
    """A socket that listens as systemd's does; a name that begins with @ is abstract."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0{name[1:]}" if name.startswith("@") else name)
        listener.settimeout(DEADLINE_S)
        yield listener


class Hanging(Idle):
    """Ticks until it is told to hang."""

    tick_hz = 50.0

    def __init__(self):
        self.hangs, self.ended = threading.Event(), threading.Event()

    def step(self, arrived: Any):
        if self.hangs.is_set():
            self.ended.wait(DEADLINE_S)
        return ()


def heard(listener):
    return listener.recv(4096).decode()


def test_a_process_is_ready_then_alive_while_its_loop_turns_and_says_that_it_stops(tmp_path, running, monkeypatch):
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "100000")
    with listening(str(tmp_path / "notify")) as listener:
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
    ("asked", "alive"),
    [
        (MINUTE, ["WATCHDOG=1"]),
        (MINUTE | {"WATCHDOG_PID": str(os.getpid())}, ["WATCHDOG=1"]),
        (MINUTE | {"WATCHDOG_PID": "1"}, []),
        ({"WATCHDOG_USEC": "0"}, []),
        ({"WATCHDOG_USEC": "soon"}, []),
    ],
)
def test_who_is_not_watched_says_nothing_of_it_and_a_status_is_one_line_said_once(asked, alive, tmp_path):
    for name in (str(tmp_path / "notify"), f"@suturegrasp-{os.getpid()}-{tmp_path.name}"):
        with listening(name) as listener:
            one = ServiceManager({"NOTIFY_SOCKET": name} | asked)
            for _ in range(3):
                one.alive()
                one.status("two\nlines")
            one.stopping()
            assert [heard(listener) for _ in range(len(alive) + 2)] == [*alive, "STATUS=two lines", "STOPPING=1"]


def test_without_a_manager_nobody_is_told_and_nothing_fails():
    # alive more than twice in each period
    for name, every_s in ((None, None), ("", None), ("/nobody/listens", pytest.approx(24.0))):
        one = ServiceManager(MINUTE | ({} if name is None else {"NOTIFY_SOCKET": name}))
        one.ready()
        one.alive()
        one.status("well")
        assert one.alive_every_s == every_s
