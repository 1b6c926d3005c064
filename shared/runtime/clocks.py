"""The time that an agent takes for now, and how far the clocks of other hosts are from this one's.

Now is this machine's time, or that of a replay while one is heard on `replay/clock`. A replay says again and again
which time it is in the recording, and how fast that goes on. In between, time goes on by itself; once nothing has been
said for a while, the replay has ended or died, and this machine's clock holds again.

Every agent answers at once, not from its loop, what its host's clock says. Asked at t and answered after d, both by the
clock here, the other clock said T at some moment in between: it is ahead by T − (t + d/2), give or take d/2 (Cristian,
Distributed Computing 3, 1989). The shortest of several round trips tells most. An agent that judges times by them has
them measured again and again, beside its loop.
"""

import contextlib
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import zenoh

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import ClockReading, HostClock, ReplayClock
from schemas.topics import REPLAY_CLOCK, key, key_root
from shared.clock import monotonic_ns, monotonic_s, now_ns
from shared.runtime.attachment import other_key
from shared.runtime.delivery import subscribe
from shared.runtime.facts import CLOCK
from shared.runtime.session import present

SILENCE_S = 1.0
"""Without a word for longer than this, a replay is over."""
JITTER_NS = 250_000_000
"""Time stands still rather than to go back by so little, which is how differently two words of a replay travel, times
its rate. What goes back farther is a replay that begins again."""
FARTHEST_NS = (1 << 63) - 1


class ReplayedTime:
    """What the clock of a replay says, from what was heard of it; seconds are of any clock that never jumps."""

    def __init__(self) -> None:
        self._heard: tuple[ReplayClock, float] | None = None
        self._last_ns: int | None = None

    def hear(self, said: ReplayClock, heard_s: float) -> None:
        """Take what the replay says."""
        self._heard = said, heard_s

    def now_ns(self, now_s: float) -> int | None:
        """The replay's time, None where none is heard."""
        if self._heard is None or now_s - self._heard[1] > SILENCE_S:
            self._last_ns = None
            return None
        said, heard_s = self._heard
        gone_ns = min(max(0.0, now_s - heard_s) * said.rate * 1e9, float(1 << 62))
        at_ns = min(said.now_ns + round(gone_ns), FARTHEST_NS)
        if self._last_ns is not None and 0 < self._last_ns - at_ns < JITTER_NS * max(1.0, said.rate):
            at_ns = self._last_ns
        self._last_ns = at_ns
        return at_ns


class AgentClock:
    """An agent's clock, which any thread may read.

    While `keeps_time` says so it goes on by the monotonic clock from where it was, whatever this machine's is set to:
    an arm that moves must not take a second for none, or none for a second.
    """

    def __init__(self, keeps_time: Callable[[], bool] = lambda: False) -> None:
        self._lock = threading.Lock()
        self._replayed = ReplayedTime()
        self._followed = False
        self._keeps_time, self._kept_from = keeps_time, (0, 0)

    def hear(self, said: ReplayClock) -> None:
        """Follow a replay, until it falls silent."""
        with self._lock:
            self._replayed.hear(said, monotonic_s())

    def now_ns(self) -> int:
        """Nanoseconds since 1970, in the recording while one is replayed."""
        with self._lock:
            replayed_ns = self._replayed.now_ns(monotonic_s())
            if replayed_ns is not None:
                self._kept_from = 0, 0
                return replayed_ns
            if not self._keeps_time():
                self._kept_from = now_ns(), monotonic_ns()
                return self._kept_from[0]
            if self._kept_from == (0, 0):
                self._kept_from = now_ns(), monotonic_ns()
            at_ns, then_ns = self._kept_from
            return at_ns + monotonic_ns() - then_ns

    def change(self) -> str:
        """What has changed since the last call, in a sentence; empty where nothing has."""
        with self._lock:
            replayed_ns = self._replayed.now_ns(monotonic_s())
            followed, self._followed = self._followed, replayed_ns is not None
        if self._followed == followed:
            return ""
        if replayed_ns is None:
            return "the replay has ended or died: the clock of this machine holds again"
        return f"a recording is replayed: its time holds for now, from {_written(replayed_ns)} on"


def _written(at_ns: int) -> str:
    try:
        return datetime.fromtimestamp(at_ns * 1e-9, UTC).isoformat(" ", "milliseconds")
    except (ValueError, OverflowError, OSError):
        return f"{at_ns} ns since 1970"


def follow_replays(session: zenoh.Session, rig: str, clock: AgentClock) -> Any:
    """Let a clock hear of the replays on a rig; what is returned is undeclared in the end."""

    def hear(sample: zenoh.Sample) -> None:
        # what says no time leaves the clock as it is
        with contextlib.suppress(MessageError):
            clock.hear(decode(ReplayClock, sample.payload.to_bytes()))

    return subscribe(session, key(rig, REPLAY_CLOCK), REPLAY_CLOCK, hear, lambda _: None)


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
        clocks: list[HostClock] = []
        for _, kind, instance in present(self._session, key_root(self._rig, "*", "*")) or []:
            if kind in self._kinds and not self._ended.is_set():
                offset = clock_offset(self._session, self._rig, kind, instance, WATCHED_TRIPS)
                told = (offset.host, offset.ahead_ms, offset.within_ms) if offset else ("", None, None)
                clocks.append(HostClock(kind, instance, *told))
        return tuple(clocks)
