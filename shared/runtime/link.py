"""What lies between this host and an agent's: how long a round trip takes, and how much passes in a second.

Every agent answers with as many bytes as it is asked for, at once, not from its loop. They are random, so that nothing
on the way can make them fewer.
"""

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import zenoh

from schemas.topics import key_root
from shared.clock import monotonic_s

LINK = "link"
"""The last part of the key under which an agent answers; nothing is published there."""
BYTES = "bytes"
MOST_BYTES = 4 << 20
FRAME_BYTES = 1_500_000
"""As many as a raw stereo pair has, of 960x540 pixels with half of the colours left out."""
ROUND_TRIPS, FRAMES = 50, 8
ANSWER_WAIT_S = 2.0


@dataclass(frozen=True)
class Link:
    """What was measured to one agent and back.

    Fields:
        latency_ms, latency_ms_p99: the median and the 99th percentile of round trips of a few bytes.
        bytes_per_s: how fast large answers come, the time of a round trip left out.
    """

    latency_ms: float
    latency_ms_p99: float
    bytes_per_s: float


def answer_link(session: zenoh.Session, root: str) -> Any:
    """Have bytes sent to whoever asks, under the root of an agent's keys; keep what is returned."""
    own, said = f"{root}/{LINK}", os.urandom(1 << 16)

    def answer(query: zenoh.Query) -> None:
        asked = query.parameters.get(BYTES) or "0"
        count = min(int(asked), MOST_BYTES) if asked.isascii() and asked.isdigit() and len(asked) < 12 else 0
        query.reply(own, (said * (count // len(said) + 1))[:count])
        query.drop()

    return session.declare_queryable(own, answer)


def measure_link(session: zenoh.Session, rig: str, kind: str, instance: str) -> Link | None:
    """What lies between here and an agent; None where it gives no answer, or not all of them."""
    key = f"{key_root(rig, instance, kind)}/{LINK}"
    short = _trips(session, key, 1, ROUND_TRIPS)
    large = _trips(session, key, FRAME_BYTES, FRAMES) if short is not None else None
    if short is None or large is None:
        return None
    latency_s = float(np.median(short))
    # no faster than what a clock can tell
    taken_s = max(float(np.median(large)) - latency_s, 1e-6)
    return Link(latency_s * 1e3, float(np.percentile(short, 99)) * 1e3, FRAME_BYTES / taken_s)


def _trips(session: zenoh.Session, key: str, count: int, times: int) -> list[float] | None:
    """Seconds that each of so many round trips took, None once an answer fails to come."""
    taken_s: list[float] = []
    for _ in range(times):
        asked_s = monotonic_s()
        replies = session.get(f"{key}?{BYTES}={count}", timeout=ANSWER_WAIT_S)
        came = sum(len(reply.ok.payload) for reply in replies if reply.ok is not None)
        if came != count:
            return None
        taken_s.append(monotonic_s() - asked_s)
    return taken_s
