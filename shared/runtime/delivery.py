"""How each delivery class is built on Zenoh (see Delivery in schemas/topics.py).

Zenoh moves large payloads through shared memory by itself, and copies them there. What is written there in the first
place is copied once instead of twice, which saves 0.4 of 3.0 ms of a raw stereo frame of 1.5 MB, and 1.0 of 4.1 ms of
one of 2.8 MB; whoever shares no memory with this process gets the same bytes by network. Without shared memory a hop
takes 1.2 ms in place of 0.9 at 85 kB, and 15 in place of 1.5 at 2.8 MB; copied there by Zenoh 2.0 at 2.8 MB
(`benchmarks.latency --only parts`, 29 November 2026).
"""

import functools
import logging
import threading
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh import ext, shm

from schemas.codec import encoded_parts
from schemas.topics import Delivery, Priority, Topic
from shared.runtime.attachment import encoding_of, other_key, why_refused
from shared.runtime.lossless import LosslessSubscriber

MISS_HEARTBEAT_S = 0.5
HANDED_OVER_S = 2.0
_PRIORITIES = {
    Priority.REAL_TIME: zenoh.Priority.REAL_TIME,
    Priority.DATA_HIGH: zenoh.Priority.DATA_HIGH,
    Priority.DATA: zenoh.Priority.DATA,
    Priority.DATA_LOW: zenoh.Priority.DATA_LOW,
    Priority.BACKGROUND: zenoh.Priority.BACKGROUND,
}
LOG = logging.getLogger("suturegrasp.delivery")

Rows = tuple[Topic, ...]
"""Rows of the table of topics as a rig has them, where it has them otherwise."""


def say_refused(key: str, named: str) -> None:
    """Say that a message came under another key than its own, for those who count no refusals."""
    LOG.warning("a message on %s was refused: %s", key, why_refused(named))


def as_told(topic: Topic, otherwise: Rows) -> Topic:
    """A row of the table as a rig has it, given the rows that the rig has otherwise."""
    return next((row for row in otherwise if str(row) == str(topic)), topic)


def payload_of(topic: Topic, message: Any) -> Any:
    """What a publisher of that topic puts for a message: large newest ones lie in shared memory from the start.

    Raises:
        MessageError: where a value does not fit its field on the wire.
    """
    parts = encoded_parts(message)
    # a cache of what must not be lost would soon fill the pool
    return joined(parts) if topic.delivery is Delivery.LATEST and len(parts) > 1 else b"".join(parts)


def declare_publisher(session: zenoh.Session, key: str, topic: Topic, waits: bool = False) -> Any:
    """A publisher of a topic that is not a command; `waits` for the network even where the topic would rather drop."""
    encoding = encoding_of(topic.message, key)
    if topic.delivery is Delivery.LATEST:
        first = topic.priority is Priority.REAL_TIME
        return session.declare_publisher(
            key,
            encoding=encoding,
            congestion_control=zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP,
            priority=_PRIORITIES[topic.priority],
            express=first,
        )
    return ext.declare_advanced_publisher(
        session,
        key,
        encoding=encoding,
        congestion_control=zenoh.CongestionControl.BLOCK,
        express=True,
        cache=ext.CacheConfig(_kept(topic)),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=MISS_HEARTBEAT_S),
        publisher_detection=True,
    )


def subscribe(
    session: zenoh.Session,
    key: str,
    topic: Topic,
    receive: Callable[[zenoh.Sample], None],
    missed: Callable[[int], None],
    refused: Callable[[str, str], None] = say_refused,
) -> Any:
    """Have every sample of a topic that is not a command handed over; keep what is returned.

    All are called from a thread that Zenoh keeps for this subscriber, and must only put things away: behind one that
    waits, 256 messages are kept, and then everything that comes to the session, commands included, waits as well.
    `missed` is told of lost events; `refused` is told the key under which a message came that names another one, and
    that one. Once it is undeclared, what had come has been handed over.
    """
    if topic.delivery is not Delivery.LATEST:
        is_event = topic.delivery is Delivery.EVENT
        return LosslessSubscriber(session, key, is_event, _kept(topic), receive, missed, refused)

    def hand_over(sample: zenoh.Sample) -> None:
        name = str(sample.key_expr)
        if named := other_key(sample.encoding, name):
            refused(name, named)
        else:
            receive(sample)

    return _Newest(session, key, hand_over)


class _Newest:
    """A subscriber whose `undeclare` ends once all that came was handed over."""

    def __init__(self, session: zenoh.Session, key: str, hand_over: Callable[[zenoh.Sample], None]) -> None:
        self._handed_over = threading.Event()
        callback = zenoh.handlers.Callback(hand_over, drop=self._handed_over.set)
        self._subscriber: Any = session.declare_subscriber(key, callback)

    def undeclare(self) -> None:
        """Hear no more."""
        self._subscriber.undeclare()
        self._handed_over.wait(HANDED_OVER_S)


def _kept(topic: Topic) -> int:
    """How many messages of a topic that must arrive are there for those who were away."""
    return topic.kept if topic.delivery is Delivery.EVENT else 1


POOL_MESSAGES = 6
"""A pool has room for so many messages of the largest size that is taken from it, twice as many of the smallest. The
memory of a small pool is written again while the processor's caches still hold it."""


def joined(parts: list[Any]) -> Any:
    """The parts as one payload: in shared memory, or as bytes where that is full or not to be had."""
    buffer = _allocated(sum(map(len, parts)))
    if buffer is None:
        return b"".join(parts)
    at = 0
    for part in parts:
        buffer[at : at + len(part)] = part if isinstance(part, bytes) else bytes(part)
        at += len(part)
    return buffer


def _allocated(size: int) -> Any:
    pool = _pool(size.bit_length())
    try:
        # of what consumers have not let go of, nothing is taken back: then it is full
        return None if pool is None else pool.alloc(size, policy=shm.GarbageCollect())
    except zenoh.ZError:
        return None


@functools.cache
def _pool(bits: int) -> Any:
    """The pool of all messages whose size has so many bits; None where no memory can be shared."""
    try:
        return shm.ShmProvider.default_backend(POOL_MESSAGES << bits)
    except zenoh.ZError:
        return None
