"""Measures the clocks of other agents' hosts again and again, beside the loop of an agent that judges times by them."""

import threading
from collections.abc import Callable, Iterable

import zenoh

from schemas.messages import HostClock
from shared.runtime.clocks import clock_offset

PERIOD_S, SOON_S = 5.0, 0.5
APART_MS = 50.0
"""Clocks so far apart are measured soon again: once they are set, nobody should wait for it to be seen."""
TRIPS = 3
"""A few round trips tell enough: the next ones follow soon."""
ENDS_S = 5.0


class ClockWatch:
    """A thread that measures until it is stopped."""

    def __init__(
        self, session: zenoh.Session, rig: str, kinds: Iterable[str], tell: Callable[[tuple[HostClock, ...]], None]
    ) -> None:
        """`kinds` of agents are asked, as many of each as there are; `tell` is called from the thread."""
        self._session, self._rig, self._kinds, self._tell = session, rig, frozenset(kinds), tell
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="clocks", daemon=True)
        self._thread.start()

    def undeclare(self) -> None:
        """End the thread: one that is still inside Zenoh when the interpreter ends aborts the process."""
        self._ended.set()
        self._thread.join(ENDS_S)

    def _watch(self) -> None:
        while not self._ended.is_set():
            clocks = self._measured()
            if self._ended.is_set():
                return
            self._tell(clocks)
            apart = any(abs(clock.ahead_ms or 0.0) > APART_MS for clock in clocks)
            self._ended.wait(SOON_S if apart else PERIOD_S)

    def _measured(self) -> tuple[HostClock, ...]:
        replies = self._session.liveliness().get(f"suturegrasp/{self._rig}/*/*", timeout=1.0)
        named = [str(reply.ok.key_expr).split("/")[2:4] for reply in replies if reply.ok is not None]
        clocks: list[HostClock] = []
        for kind, instance in sorted(named):
            if kind in self._kinds and not self._ended.is_set():
                offset = clock_offset(self._session, self._rig, kind, instance, TRIPS)
                told = (offset.host, offset.ahead_ms, offset.within_ms) if offset else ("", None, None)
                clocks.append(HostClock(kind, instance, *told))
        return tuple(clocks)
