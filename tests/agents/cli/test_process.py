"""How a process of a rig ends when it is told to."""

import signal
import subprocess
import sys

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
    command = [sys.executable, "-c", BEGINS + WAITS.format(stop=stop)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=60.0)
    return process.returncode, said


def test_a_process_ends_without_a_word_or_says_where_it_stands_and_ends_all_the_same():
    assert terminated("stopped.set") == (0, "")
    status, said = terminated("lambda: None")
    assert status == 1
    assert 'File "<string>", line 9 in <module>' in said


def test_a_signal_that_another_thread_takes_ends_a_process_that_waits_without_a_limit():
    program = [sys.executable, "-c", BEGINS + TAKEN_BY_ANOTHER]
    assert subprocess.run(program, timeout=60.0, check=False).returncode == 0


def test_a_signal_of_a_process_that_forked_off_is_none_of_its_own():
    program = [sys.executable, "-c", BEGINS + FORKED]
    assert subprocess.run(program, timeout=60.0, check=True, capture_output=True, text=True).stdout == "goes on\n"
