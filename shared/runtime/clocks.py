"""How far the clocks of other hosts are from this one's.

Every agent answers at once, not from its loop, what its host's clock says. Asked at t and answered after d, both by the
clock here, the other clock said T at some moment in between: it is ahead by T − (t + d/2), give or take d/2 (Cristian,
Distributed Computing 3, 1989). The shortest of several round trips tells most. An agent that judges times by them has
them measured again and again, beside its loop.
"""

import socket
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import zenoh

from schemas.checks import MessageError
from schemas.codec import decode, encode
from schemas.messages import ClockReading, HostClock
from schemas.topics import key_root
from shared.clock import monotonic_s, now_ns
from shared.runtime.attachment import encoding_of, other_key

CLOCK = "clock"
"""The last part of the key under which an agent answers; nothing is published there."""
TRIPS = 8
ANSWER_WAIT_S = 1.0


@dataclass(frozen=True)
class ClockOffset:
    """How far a host's clock is ahead of this one's (negative: behind), and how much that may be wrong."""

    host: str
    ahead_ms: float
    within_ms: float

    @property
    def least_ms(self) -> float:
        """How far the clocks are apart for certain."""
        return max(0.0, abs(self.ahead_ms) - self.within_ms)


def answer_clock(session: zenoh.Session, rig: str, kind: str, instance: str) -> Any:
    """Have this host's clock told to whoever asks the agent; keep what is returned."""
    host, own = socket.gethostname(), f"{key_root(rig, instance, kind)}/{CLOCK}"

    def answer(query: zenoh.Query) -> None:
        reading = encode(ClockReading(host, now_ns()))
        query.reply(own, reading, encoding=encoding_of(ClockReading, own))
        query.drop()

    return session.declare_queryable(own, answer)


def clock_offset(session: zenoh.Session, rig: str, kind: str, instance: str, trips: int = TRIPS) -> ClockOffset | None:
    """How far the clock of an agent's host is from this one's; None where it gives no answer."""
    best: ClockOffset | None = None
    for _ in range(trips):
        found = _one_trip(session, f"{key_root(rig, instance, kind)}/{CLOCK}")
        if found is None:
            break
        best = found if best is None or found.within_ms < best.within_ms else best
    return best


def offset_of(reading: ClockReading, asked_ns: int, took_s: float) -> ClockOffset:
    """What a reading tells that was asked for then, and came after so long."""
    half_ns = 0.5e9 * took_s
    return ClockOffset(reading.host, (reading.at_ns - asked_ns - half_ns) * 1e-6, half_ns * 1e-6)


def by_host(offsets: Iterable[ClockOffset]) -> list[ClockOffset]:
    """Of the readings of each host the one that is farthest from this clock for certain.

    Two hosts may have one name; then the worse of them shows.
    """
    hosts: dict[str, ClockOffset] = {}
    for offset in offsets:
        known = hosts.get(offset.host)
        if known is None or (offset.least_ms, -offset.within_ms) > (known.least_ms, -known.within_ms):
            hosts[offset.host] = offset
    return [hosts[host] for host in sorted(hosts)]


def _one_trip(session: zenoh.Session, key: str) -> ClockOffset | None:
    # what passes between the two readings must be within the round trip, which bounds the error
    asked_s, asked_ns = monotonic_s(), now_ns()
    for reply in session.get(key, timeout=ANSWER_WAIT_S):
        took_s = monotonic_s() - asked_s
        if reply.ok is not None and not other_key(reply.ok.encoding, key):
            try:
                return offset_of(decode(ClockReading, reply.ok.payload.to_bytes()), asked_ns, took_s)
            except MessageError:
                return None
    return None


PERIOD_S, SOON_S = 5.0, 0.5
APART_MS = 50.0
"""Clocks so far apart are measured soon again: once they are set, nobody should wait for it to be seen."""
WATCHED_TRIPS = 3
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
                offset = clock_offset(self._session, self._rig, kind, instance, WATCHED_TRIPS)
                told = (offset.host, offset.ahead_ms, offset.within_ms) if offset else ("", None, None)
                clocks.append(HostClock(kind, instance, *told))
        return tuple(clocks)
