"""A relay that carries as a bad network does: with constant, growing, or bursting delays, loss, reordering.

    python -m tests.rigs.robot.relay LISTEN TARGET MODE SECONDS

Ports of this machine. It carries at once until SIGUSR1, and by the mode from then on: `constant` holds everything back
for so long, `growing` half a second longer each second up to that, `bursts` lets nothing through but once in so
long, and `cut` nothing at all. Of Zenoh's messages `loss` loses one in five, and `reordered` holds each back for a time
of its own, up to so long, so that later ones overtake it.
"""

import contextlib
import heapq
import itertools
import random
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator

from shared.clock import monotonic_s

GROWS = 0.5
"""Seconds of delay a second."""
LOOK_S = 0.002
LOST_SHARE = 0.2


def delay_of(mode: str, seconds: float, since_s: float, chance: float) -> float | None:
    """How long what comes so long after the beginning of a mode is held back; None where it is lost."""
    match mode:
        case "loss":
            return None if chance < LOST_SHARE else 0.0
        case "reordered":
            return chance * seconds
        case "constant":
            return seconds
        case "growing":
            return min(seconds, GROWS * since_s)
        case "bursts":
            return seconds - since_s % seconds
        case _:
            return 1e9


def _serve(listen: int, target: int, due_s: Callable[[float], float | None], ordered: bool) -> None:
    """Carry between the two ports until killed."""
    server = socket.create_server(("127.0.0.1", listen))
    while True:
        ours, _ = server.accept()
        try:
            theirs = socket.create_connection(("127.0.0.1", target))
        except OSError:
            ours.close()
            continue
        for ends in ((ours, theirs), (theirs, ours)):
            ends[0].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=_carry, args=(*ends, due_s, ordered), daemon=True).start()


def _carry(source: socket.socket, target: socket.socket, due_s: Callable[[float], float | None], ordered: bool) -> None:
    """Each message as late as it is due; where they are `ordered`, none before one that came earlier."""
    queue, filled, ended = list[tuple[float, int, bytes]](), threading.Event(), threading.Event()
    lock = threading.Lock()

    def send() -> None:
        with contextlib.suppress(OSError):
            while queue or not ended.is_set():
                filled.wait(0.1)
                with lock:
                    first = queue[0] if queue else None
                    if first is None:
                        filled.clear()
                    elif first[0] <= monotonic_s():
                        heapq.heappop(queue)
                if first is not None and (left_s := first[0] - monotonic_s()) > 0:
                    threading.Event().wait(min(left_s, LOOK_S))
                elif first is not None:
                    target.sendall(first[2])
            target.shutdown(socket.SHUT_WR)

    threading.Thread(target=send, daemon=True).start()
    last_s, count = 0.0, itertools.count()
    with contextlib.suppress(OSError):
        for message in _messages(source):
            due = due_s(monotonic_s())
            if due is not None:
                last_s = max(last_s, due) if ordered else due
                with lock:
                    heapq.heappush(queue, (last_s, next(count), message))
                filled.set()
    ended.set()


def _messages(source: socket.socket) -> Iterator[bytes]:
    """Zenoh's messages on a stream, each with the two bytes before it that say its length."""
    held = b""
    while data := source.recv(1 << 16):
        held += data
        while len(held) >= 2 and len(held) >= (whole := 2 + int.from_bytes(held[:2], "little")):
            yield held[:whole]
            held = held[whole:]


def main(listen: str, target: str, mode: str = "constant", seconds: str = "0") -> None:
    """Carry until killed."""
    began_s: list[float] = []

    def due_s(came_s: float) -> float | None:
        delay_s = delay_of(mode, float(seconds), came_s - began_s[0], random.random()) if began_s else 0.0
        return None if delay_s is None else came_s + delay_s

    signal.signal(signal.SIGUSR1, lambda *_: began_s.append(monotonic_s()))
    _serve(int(listen), int(target), due_s, mode != "reordered")


if __name__ == "__main__":
    main(*sys.argv[1:])
