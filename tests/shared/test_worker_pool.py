"""Workers share what they are given, and end with whoever started them, however that ends."""

import os
import signal
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from shared.worker_pool import worker_pool

AT_WORK = """
import signal
from shared.worker_pool import worker_pool

# what is started in the background may have been told to ignore it
signal.signal(signal.SIGINT, signal.default_int_handler)
with worker_pool(2) as pool:
    # each says who it is once it is at work: by then, whoever started it waits
    # in one write, for both write to one pipe
    work = "import os, signal; os.write(1, str(os.getpid()).encode() + bytes([10])); signal.pause()"
    endless = [pool.submit(exec, work) for _ in range(2)]
    endless[0].result()
"""


def lives(pid):
    """Whether a process is there and more than a name whose end nobody asked for."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked for where Linux lists them")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_workers_end_where_whoever_started_them_is_ended(until, number):
    begun = subprocess.Popen(
        [sys.executable, "-c", AT_WORK],
        cwd=Path(__file__).parents[2],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        # in a group of its own, so that the workers are not told with it
        start_new_session=True,
    )
    assert begun.stdout is not None
    with begun as process:
        try:
            workers = [int(begun.stdout.readline()) for _ in range(2)]
            process.send_signal(number)
            assert process.wait() != 0
            until(lambda: not any(map(lives, workers)), "the workers' end")
        finally:
            process.kill()


def test_workers_are_made_ready_hear_no_ctrl_c_and_are_gone_afterwards_and_one_that_dies_is_no_silence(tmp_path):
    # what is started by tests that ignore it would ignore it too
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with worker_pool(1, os.chdir, (tmp_path,)) as pool:
            worker = pool.submit(os.getpid).result()
            assert worker != os.getpid()
            os.kill(worker, signal.SIGINT)
            assert Path(pool.submit(os.getcwd).result()) == tmp_path
            assert pool.submit(os.getpid).result() == worker
        assert not lives(worker)
    finally:
        signal.signal(signal.SIGINT, before)
    with pytest.raises(BrokenProcessPool), worker_pool(1) as pool:
        pool.submit(os._exit, 3).result()
