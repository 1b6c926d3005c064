"""How a process of a rig ends when it is told to."""

import signal
import subprocess
import sys

PROGRAM = """
import threading
from agents.cli.running import process
process.ENDS_WITHIN_S = 0.2
stopped = threading.Event()
process.on_stop({stop}, for_sure=True)
print("up", flush=True)
stopped.wait()
"""


def ended(stop):
    """What becomes of a process that is told to end and does this; its status, and what it says."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(stop=stop)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=60.0)
    return process.returncode, said


def test_a_process_that_stops_when_told_to_ends_without_a_word():
    assert ended("stopped.set") == (0, "")


def test_a_process_that_does_not_stop_says_where_it_stands_and_ends_all_the_same():
    status, said = ended("lambda: None")
    assert status == 1
    assert 'File "<string>", line 8 in <module>' in said
