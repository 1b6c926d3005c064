"""What every process of a rig does alike: a clean stop on SIGINT and SIGTERM, its place in the queue, its log."""

import contextlib
import faulthandler
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from agents.launch.supervisor import SUPERVISED, UNUSABLE

EXIT_OK, EXIT_GAVE_UP, EXIT_UNUSABLE, EXIT_DAMAGED = 0, 1, UNUSABLE, 3
STOPPING = signal.SIGINT, signal.SIGTERM
ENDS_WITHIN_S, STANDARD_ERROR = 20.0, 2
"""Less than a service manager waits before it kills."""
NICENESS, ONLOOKER = 8, 15
"""What takes all the time it gets, and leaves out images for newer ones, steps back behind what keeps time: the arm,
the field and the camera. What only shows them steps back farther."""
AUTOGROUP = Path("/proc/self/autogroup")
"""Where Linux shares time among sessions before it does among processes, which makes niceness within one moot."""
LOGGER = logging.getLogger("suturegrasp")
LINE = logging.Formatter("%(asctime)s %(name)s %(levelname)s: %(message)s", "%H:%M:%S")


def step_back(niceness: int = NICENESS) -> None:
    """Leave the processor to whatever is more urgent, where the system can."""
    if hasattr(os, "nice"):
        os.nice(niceness)
    # a process of its own session is nice to nobody else's, so the session has to be
    with contextlib.suppress(OSError):
        if os.getsid(0) == os.getpid():
            AUTOGROUP.write_text(str(niceness))


def on_stop(stop: Callable[[], None], for_sure: bool = False) -> None:
    """Have SIGINT and SIGTERM call this, and the end of the supervisor, if there is one.

    `for_sure`: a process that has not ended ENDS_WITHIN_S later says where each of its threads is, and ends with
    EXIT_GAVE_UP. On a busy machine, the closing of a session has stood still for longer than anybody waits.
    """

    def from_another_thread() -> None:
        if for_sure:
            faulthandler.dump_traceback_later(ENDS_WITHIN_S, exit=True, file=STANDARD_ERROR)
        # whoever stops may wait for long, and is to be asked again all the same
        threading.Thread(target=stop, name="stop", daemon=True).start()

    for number in STOPPING:
        signal.signal(number, _noted)
    written = _written_by_signals()
    threading.Thread(
        target=_stop_with_signals, args=(written, from_another_thread), name="signals", daemon=True
    ).start()
    if os.environ.pop(SUPERVISED, ""):
        threading.Thread(
            target=_stop_with_supervisor, args=(from_another_thread,), name="supervisor", daemon=True
        ).start()


def stopping(for_sure: bool = False) -> threading.Event:
    """What is set when this process is told to stop, as `on_stop` has it."""
    stopped = threading.Event()
    on_stop(stopped.set, for_sure)
    return stopped


def _noted(*_: object) -> None:
    """Whoever reads what the signal wrote does what is to be done.

    Python calls this in the main thread alone, and where another one took the signal, not before that wakes.
    """


def _written_by_signals() -> socket.socket:
    """Where each signal of this process writes its number, whichever thread takes it."""
    reading, writing = socket.socketpair()
    writing.setblocking(False)
    signal.set_wakeup_fd(writing.detach(), warn_on_full_buffer=False)
    # a signal of a process that forks off is none of this one
    os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))
    return reading


def _stop_with_signals(written: socket.socket, stop: Callable[[], None]) -> None:
    while numbers := written.recv(64):
        if any(number in STOPPING for number in numbers):
            stop()


def _stop_with_supervisor(stop: Callable[[], None]) -> None:
    while os.read(0, 1):
        pass
    stop()


def log_to_console() -> logging.Handler:
    """Send this process's log lines to standard error too, until the handler that returns is removed."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(LINE)
    LOGGER.addHandler(handler)
    return handler
