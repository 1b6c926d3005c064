"""What lies between this host and an agent's: how long a round trip takes, and how much passes in a second.

Every agent answers with as many bytes as it is asked for, at once, not from its loop; so the way from it is measured,
and the way to it by questions that carry as many. All are random, so that nothing on the way can make them fewer.
"""

import os
from collections.abc import Callable
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
LEAST_BYTES = 1 << 16
GROWTH, TRIED = 4, 3
LONG_ENOUGH_S = 0.025
"""More is sent at once until it takes so long. An arm holds where its operator's heartbeat is 200 ms late, and what
measures a link must not be why."""
ROUND_TRIPS, FRAMES = 50, 8
MEASURED_S = 1.0
"""How long a slow link is kept busy in either direction."""
ANSWER_WAIT_S = 2.0


@dataclass(frozen=True)
class Link:
    """What was measured to one agent and back.

    Fields:
        latency_ms, latency_ms_p99: the median and the 99th percentile of round trips of a few bytes.
        bytes_per_s, bytes_per_s_there: how fast large answers come from it, and large questions reach it, the time of
            a round trip left out; at most so fast where one took too long to be waited for.
    """

    latency_ms: float
    latency_ms_p99: float
    bytes_per_s: float
    bytes_per_s_there: float


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
    """What lies between here and an agent; None where it gives no answer."""
    key, said = f"{key_root(rig, instance, kind)}/{LINK}", os.urandom(FRAME_BYTES)
    short: list[float] = []
    for _ in range(ROUND_TRIPS):
        took_s = _trip_s(session, key, 1)
        if took_s is None:
            return None
        short.append(took_s)
    latency_s = float(np.median(short))
    from_there = throughput(lambda count: _trip_s(session, key, count), latency_s)
    there = throughput(lambda count: _trip_s(session, key, 1, said[:count]), latency_s)
    return Link(latency_s * 1e3, float(np.percentile(short, 99)) * 1e3, from_there, there)


def throughput(trip_s: Callable[[int], float | None], latency_s: float) -> float:
    """Bytes that pass in a second.

    `trip_s` tells how long a round trip with so many bytes took, None where it was waited for in vain; `latency_s` is
    what one without any takes.
    """
    count, taken_s = LEAST_BYTES, list[float]()
    while len(taken_s) < FRAMES and sum(taken_s) < MEASURED_S:
        took_s = trip_s(count)
        if took_s is None:
            return count / ANSWER_WAIT_S
        taken_s.append(took_s)
        # one that was held up by something else tells nothing
        if count < FRAME_BYTES and len(taken_s) == TRIED and np.median(taken_s) - latency_s < LONG_ENOUGH_S:
            count, taken_s = min(GROWTH * count, FRAME_BYTES), []
    # no faster than what a clock can tell
    return count / max(float(np.median(taken_s)) - latency_s, 1e-6)


def _trip_s(session: zenoh.Session, key: str, asked: int, said: bytes = b"") -> float | None:
    """Seconds that a round trip took, None where its answer did not come."""
    began_s = monotonic_s()
    blocks = zenoh.CongestionControl.BLOCK
    selector = f"{key}?{BYTES}={asked}"
    replies = session.get(selector, payload=said, congestion_control=blocks, timeout=ANSWER_WAIT_S)
    came = sum(len(reply.ok.payload) for reply in replies if reply.ok is not None)
    return monotonic_s() - began_s if came == asked else None
