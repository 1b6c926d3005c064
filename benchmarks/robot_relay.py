"""A relay that queues what it carries, as a bad network does: by constant, growing, or bursting delays.

    python -m benchmarks.robot_relay LISTEN TARGET MODE SECONDS

Ports of this machine. It carries at once until SIGUSR1, and by the mode from then on: `constant` holds everything back
for so long, `growing` a tenth of a second longer each second up to that, `bursts` lets nothing through but once in so
long, and `cut` nothing at all.
"""

import contextlib
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable

from shared.clock import monotonic_s

GROWS = 0.5
"""Seconds of delay a second."""
LOOK_S = 0.002


def delay_of(mode: str, seconds: float, since_s: float) -> float:
    """How long what comes so long after the beginning of a mode is held back."""
    if mode == "constant":
        return seconds
    if mode == "growing":
        return min(seconds, GROWS * since_s)
    if mode == "bursts":
        return seconds - since_s % seconds
    return 1e9


class Relay:
    """Carries between the two ports."""

    def __init__(self, listen: int, target: int, mode: str, seconds: float) -> None:
        self._target, self._mode, self._seconds = target, mode, seconds
        self._began_s: float | None = None
        self._server = socket.create_server(("127.0.0.1", listen))

    def begin(self) -> None:
        """Carry by the mode from now on."""
        self._began_s = monotonic_s()

    def run(self) -> None:
        """Until killed."""
        while True:
            ours, _ = self._server.accept()
            try:
                theirs = socket.create_connection(("127.0.0.1", self._target))
            except OSError:
                ours.close()
                continue
            for ends in ((ours, theirs), (theirs, ours)):
                ends[0].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=_carry, args=(*ends, self._due_s), daemon=True).start()

    def _due_s(self, came_s: float) -> float:
        began_s = self._began_s
        return came_s if began_s is None else came_s + delay_of(self._mode, self._seconds, came_s - began_s)


def _carry(source: socket.socket, target: socket.socket, due_s: Callable[[float], float]) -> None:
    """What comes first goes first, each as late as it is due."""
    queue, filled, ended = deque[tuple[float, bytes]](), threading.Event(), threading.Event()

    def send() -> None:
        last_s = 0.0
        with contextlib.suppress(OSError):
            while queue or not ended.is_set():
                filled.wait(0.1)
                if not queue:
                    filled.clear()
                    continue
                came_s = queue[0][0]
                last_s = max(last_s, due_s(came_s))
                if (left_s := last_s - monotonic_s()) > 0:
                    threading.Event().wait(min(left_s, LOOK_S))
                    continue
                target.sendall(queue.popleft()[1])
            target.shutdown(socket.SHUT_WR)

    threading.Thread(target=send, daemon=True).start()
    with contextlib.suppress(OSError):
        while data := source.recv(1 << 16):
            queue.append((monotonic_s(), data))
            filled.set()
    ended.set()


def main(listen: str, target: str, mode: str = "constant", seconds: str = "0") -> None:
    """Carry until killed."""
    relay = Relay(int(listen), int(target), mode, float(seconds))
    threading.Thread(target=relay.run, daemon=True).start()
    begun = threading.Event()
    signal.signal(signal.SIGUSR1, lambda *_: begun.set())
    while not begun.wait(0.005):
        pass
    relay.begin()
    threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
