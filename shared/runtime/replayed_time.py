"""The time that an agent takes for now: this machine's, or that of a replay while one is heard on `replay/clock`.

A replay says again and again which time it is in the recording, and how fast that goes on. In between, time goes on by
itself; once nothing has been said for a while, the replay has ended or died, and this machine's clock holds again.
"""

import contextlib
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import zenoh

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import ReplayClock
from schemas.topics import REPLAY_CLOCK, key
from shared.clock import monotonic_ns, monotonic_s, now_ns
from shared.runtime.delivery import subscribe

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


def follow_replays(session: zenoh.Session, rig: str, clock: AgentClock) -> list[Any]:
    """Let a clock hear of the replays on a rig; what is returned is undeclared in the end."""

    def hear(sample: zenoh.Sample) -> None:
        # what says no time leaves the clock as it is
        with contextlib.suppress(MessageError):
            clock.hear(decode(ReplayClock, sample.payload.to_bytes()))

    return subscribe(session, key(rig, REPLAY_CLOCK), REPLAY_CLOCK, hear, lambda _: None)
