"""Says when the link to the router was down, so that what stood still meanwhile has its reason in the log."""

import threading
from collections.abc import Callable
from typing import Any

import zenoh

from shared.clock import monotonic_s

ENDS_S = 5.0


class RouterWatch:
    """Tells in a sentence of each time that the link was down, once it is up again, from a thread of its own."""

    def __init__(self, session: zenoh.Session, tell: Callable[[str], None]) -> None:
        self._listener = session.info.declare_transport_events_listener(zenoh.handlers.FifoChannel(16))
        self._thread = threading.Thread(target=_watch, args=(self._listener.handler, tell), name="router", daemon=True)
        self._thread.start()

    def undeclare(self) -> None:
        """End it: a thread that is still inside Zenoh when the interpreter ends aborts the process."""
        self._listener.undeclare()
        self._thread.join(ENDS_S)


def _watch(events: Any, tell: Callable[[str], None]) -> None:
    down_s: float | None = None
    try:
        while True:
            event = events.recv()
            if event.kind == zenoh.SampleKind.DELETE:
                down_s = down_s or monotonic_s()
            elif down_s is not None:
                away_s, down_s = monotonic_s() - down_s, None
                tell(f"the link to the router broke, and was back after {away_s:.1f} s")
    except zenoh.ZError:
        return
