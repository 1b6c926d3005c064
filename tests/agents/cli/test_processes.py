"""Processes of a rig, with small real ones: what dies is named and comes back, a mistake does not, all of it ends."""

import os
import signal
import subprocess
import sys

import psutil
import pytest

from agents.launch.supervisor import FIRST_BACKOFF_S, LONGEST_BACKOFF_S, Role, Supervisor, supervised
from shared.clock import monotonic_s

PYTHON = (sys.executable, "-c")
STAYS = "print('here', flush=True); import sys; sys.stdin.read()"
DEADLINE_S = 60.0


@pytest.fixture
def changes_of(until):
    """The next so many changes."""

    def watch(supervisor, count):
        found = []
        until(lambda: found.extend(supervisor.watch()) or len(found) >= count)
        return found

    return watch


@pytest.fixture
def started(until):
    """The process id of a child, once it has said that it is here."""

    def wait(child):
        return until(lambda: child.log.exists() and "here" in child.log.read_text()) and child.process.pid

    return wait


@pytest.fixture
def supervisor():
    supervisor = Supervisor(program=PYTHON)
    yield supervisor
    supervisor.stop()


def test_a_killed_process_is_named_and_started_again(supervisor, started, changes_of, tmp_path):
    child = supervisor.add("perception", [STAYS], tmp_path / "log")
    pid = started(child)
    os.kill(pid, signal.SIGKILL)
    ended, again = changes_of(supervisor, 2)
    assert ended.sentence == f"perception was ended by SIGKILL; it starts again in {FIRST_BACKOFF_S:.1f} s"
    assert (ended.status, ended.final) == (-signal.SIGKILL, False)
    assert again.sentence == "perception was started again (restart 1)"
    assert child.running
    assert child.process.pid != pid


def test_the_wait_before_each_restart_grows_up_to_a_limit(supervisor, changes_of, tmp_path, monkeypatch):
    monkeypatch.setattr("agents.launch.supervisor.STEADY_S", 10 * DEADLINE_S)
    child = supervisor.add("crashes", ["raise SystemExit(3)"], tmp_path / "log")
    waits = []
    while len(waits) < 8:
        before_s = monotonic_s()
        changes_of(supervisor, 1)
        waits.append(child.due_s - before_s)
        # the wait itself is left out
        child.due_s = monotonic_s()
        changes_of(supervisor, 1)
    expected = [min(FIRST_BACKOFF_S * 2**i, LONGEST_BACKOFF_S) for i in range(8)]
    assert all(wait >= least for wait, least in zip(waits, expected, strict=True))
    assert (child.restarts, child.backoff_s) == (8, LONGEST_BACKOFF_S)


MISTAKE = "import sys; print('suturegrasp: camera.left is missing', file=sys.stderr); sys.exit(2)"


@pytest.mark.parametrize(
    ("restart", "code", "told"),
    [
        (True, MISTAKE, "camera ended with status 2: camera.left is missing"),
        (False, "raise SystemExit(1)", "camera ended with status 1: it said nothing"),
    ],
)
def test_a_mistake_in_the_configuration_or_what_is_not_to_be_restarted_ends_once(
    changes_of, tmp_path, restart, code, told
):
    with supervised(restart=restart) as supervisor:
        supervisor.program = PYTHON
        child = supervisor.add("camera", [code], tmp_path / "log")
        (change,) = changes_of(supervisor, 1)
        assert (change.sentence, change.final) == (told, True)
        assert (supervisor.watch(), child.running, child.due_s) == ([], False, None)


def test_processes_end_in_the_order_of_their_roles(started, tmp_path, monkeypatch):
    monkeypatch.setattr("agents.launch.supervisor.STOP_LIMIT_S", DEADLINE_S)
    written = tmp_path / "order"
    code = (
        "import signal, sys\n"
        f"def end(*_):\n    open({str(written)!r}, 'a').write(sys.argv[1] + ' '); sys.exit(0)\n"
        "signal.signal(signal.SIGTERM, end); print('here', flush=True)\n"
        "while True: signal.pause()"
    )
    supervisor = Supervisor(program=PYTHON)
    for role in (Role.ROUTER, Role.RECORDER, Role.VIEWER, Role.AGENT):
        started(supervisor.add(role.name, [code, role.name], tmp_path / role.name, role))
    supervisor.stop()
    assert written.read_text().split() == ["AGENT", "VIEWER", "RECORDER", "ROUTER"]
    assert not any(child.running for child in supervisor.children)


def test_a_process_that_does_not_listen_is_killed(started, tmp_path, monkeypatch):
    monkeypatch.setattr("agents.launch.supervisor.STOP_LIMIT_S", 0.2)
    code = "import signal; signal.signal(15, signal.SIG_IGN); print('here', flush=True)\nwhile True: signal.pause()"
    supervisor = Supervisor(program=PYTHON)
    child = supervisor.add("deaf", [code], tmp_path / "log")
    started(child)
    process = child.process
    supervisor.stop()
    assert process is not None
    assert process.returncode == -signal.SIGKILL


@pytest.mark.slow
def test_processes_end_with_a_supervisor_that_is_killed(tmp_path):
    config = tmp_path / "rig.toml"
    config.write_text('[router]\nendpoint = "tcp/127.0.0.1:1"\nstart = false\n[planner]\n')
    code = (
        "import pathlib, sys; from agents.launch.supervisor import Supervisor\n"
        f"log, arguments = pathlib.Path({str(tmp_path / 'log')!r}), ['planner', '--config', {str(config)!r}]\n"
        "child = Supervisor().add('planner', arguments, log)\n"
        "print(child.process.pid, flush=True); sys.stdin.read()"
    )
    with subprocess.Popen([*PYTHON, code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        orphan = psutil.Process(int(parent.stdout.readline()))
        parent.kill()
    _, alive = psutil.wait_procs([orphan], timeout=DEADLINE_S)
    for process in alive:
        process.kill()
    assert not alive


BEGINS = """
import os, signal, sys, threading
from agents.launch import process
process.ENDS_WITHIN_S = 0.2
stopped = threading.Event()
"""
WAITS = """
process.on_stop({stop}, for_sure=True)
print("up", flush=True)
stopped.wait()
"""
TAKEN_BY_ANOTHER = """
process.on_stop(stopped.set)
other = threading.Thread(target=threading.Event().wait, daemon=True)
other.start()
threading.Timer(0.2, signal.pthread_kill, (other.ident, signal.SIGTERM)).start()
stopped.wait()
"""
FORKED = """
process.on_stop(stopped.set)
child = os.fork()
if child == 0:
    os.kill(os.getpid(), signal.SIGTERM)
    os._exit(0)
os.waitpid(child, 0)
print("stopped" if stopped.wait(0.5) else "goes on")
"""


def terminated(stop):
    """The status of a process that is told to end and then does this, and what it says."""
    command = [*PYTHON, BEGINS + WAITS.format(stop=stop)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=DEADLINE_S)
    return process.returncode, said


def test_a_process_ends_without_a_word_or_says_where_it_stands_and_ends_all_the_same():
    assert terminated("stopped.set") == (0, "")
    status, said = terminated("lambda: None")
    assert status == 1
    assert 'File "<string>", line 9 in <module>' in said


def test_a_signal_that_another_thread_takes_ends_a_process_and_that_of_a_fork_does_not():
    program = [*PYTHON, BEGINS + TAKEN_BY_ANOTHER]
    assert subprocess.run(program, timeout=DEADLINE_S, check=False).returncode == 0
    program = [*PYTHON, BEGINS + FORKED]
    assert subprocess.run(program, timeout=DEADLINE_S, check=True, capture_output=True).stdout == b"goes on\n"
