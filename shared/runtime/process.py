"""What a process asks of its system: that freed memory is kept, and that its service manager knows how it goes.

glibc gives large blocks back to the system at once, and takes them again page by page: for images at 30 Hz that costs
more than whatever is done with them. Elsewhere than on glibc nothing is asked.

systemd is told (sd_notify) ready, alive, how it goes, stopping: one datagram each, to the socket that NOTIFY_SOCKET
names; where that is unset, nobody is told anything.
"""

import contextlib
import ctypes
import os
import socket
from collections.abc import Generator, Mapping

from shared.clock import monotonic_s

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""glibc's names for its parameters (malloc.h)."""
KEPT_BYTES = 1 << 28
"""Free memory at the end of the heap from which on it is given back."""
LARGEST_BLOCK_BYTES = 1 << 25
"""Larger ones still come from the system one by one; glibc takes no greater number."""


def keep_freed_memory() -> bool:
    """Have this process keep what it frees; whether the system's C library can."""
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        return bool(mallopt(TRIM_THRESHOLD, KEPT_BYTES) and mallopt(MMAP_THRESHOLD, LARGEST_BLOCK_BYTES))
    return False


class ServiceManager:
    """The one that started this process, if any did.

    Fields:
        alive_every_s: how often it wants to hear that the process is alive, halved; None where it does not watch.
    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        asked = os.environ if environment is None else environment
        self._address = _address(asked.get("NOTIFY_SOCKET", ""))
        self.alive_every_s = _period_s(asked) if self._address is not None else None
        self._alive_s: float | None = None
        self._status = ""

    def ready(self) -> None:
        """The process listens."""
        self._tell("READY=1")

    def alive(self) -> None:
        """A turn of the process's own loop: so one that hangs is noticed. Told at half the period that is watched."""
        now_s = monotonic_s()
        if self.alive_every_s is None or (self._alive_s is not None and now_s - self._alive_s < self.alive_every_s):
            return
        self._alive_s = now_s
        self._tell("WATCHDOG=1")

    def status(self, text: str) -> None:
        """How it goes, in one line; said again only when it changes."""
        line = text.replace("\n", " ")
        if line != self._status:
            self._status = line
            self._tell(f"STATUS={line}")

    def stopping(self) -> None:
        """The process ends, as it was told to."""
        self._tell("STOPPING=1")

    def _tell(self, line: str) -> None:
        if self._address is None:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
                sender.setblocking(False)
                sender.sendto(line.encode(errors="replace"), self._address)
        except OSError:
            # a manager that does not listen, or is behind, must not hold the process up
            return


@contextlib.contextmanager
def serving() -> Generator[None]:
    """Ready from now on, and stopping afterwards: for what has no loop of its own that could hang."""
    manager = ServiceManager()
    manager.ready()
    yield
    manager.stopping()


def _address(named: str) -> str | None:
    """The address of a socket; a name that begins with @ is abstract, and begins with a zero byte."""
    if named.startswith("@"):
        return f"\0{named[1:]}"
    return named if named.startswith("/") else None


def _period_s(asked: Mapping[str, str]) -> float | None:
    """Less than half of what WATCHDOG_USEC says, where it is meant for this process."""
    period, meant_for = asked.get("WATCHDOG_USEC", ""), asked.get("WATCHDOG_PID", "")
    if not period.isdigit() or int(period) == 0 or meant_for not in ("", str(os.getpid())):
        return None
    return 0.4e-6 * int(period)
