"""How each delivery class is built on Zenoh (see Delivery in schemas/topics.py).

Zenoh moves large payloads through shared memory by itself, and copies them there. What is written there in the first
place is copied once instead of twice, which saves 0.4 of 3.0 ms of a raw stereo frame of 1.5 MB, and 1.0 of 4.1 ms of
one of 2.8 MB; whoever shares no memory with this process gets the same bytes by network.

Samples of an input that is only remembered wait as they came until somebody wants to know of them. A thread that wakes
for each of them finds nothing of what it needs in the processor's caches: to look at one alone took ten times as long.
"""

import functools
import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh import ext, shm

from schemas.codec import encoded_parts
from schemas.topics import Delivery, Priority, Topic
from shared.clock import monotonic_s
from shared.runtime.accounts import RingLosses
from shared.runtime.attachment import encoding_of, other_key, unpack, why_refused
from shared.runtime.lossless import LosslessSubscriber

MOST = 48
"""Samples and marks; what waits holds on to memory that is shared with its publisher."""


class Unlooked:
    """What waits between the thread that receives and whoever looks."""

    def __init__(
        self, look_at: Callable[[Any, float], None], emptied: Callable[[], None], at_once: Callable[[], bool]
    ) -> None:
        """`look_at` is given a sample, and when it came; `emptied` is called where the ring was seen empty between.

        `at_once` tells whether they may not wait at the moment.
        """
        self._look_at, self._emptied, self._at_once = look_at, emptied, at_once
        self._waiting: deque[tuple[Any, float]] = deque()
        self._looking = threading.Lock()

    def put(self, sample: Any) -> None:
        """Have a sample wait; None where the ring was seen empty."""
        self._waiting.append((sample, monotonic_s()))
        if len(self._waiting) >= MOST or self._at_once():
            self.look()

    def look(self) -> None:
        """Look at all that waits; any thread may."""
        if not self._waiting:
            return
        with self._looking:
            while self._waiting:
                sample, came_s = self._waiting.popleft()
                if sample is None:
                    self._emptied()
                else:
                    self._look_at(sample, came_s)


MISS_HEARTBEAT_S = 0.5
ENDS_S = 5.0
_PRIORITIES = {
    Priority.REAL_TIME: zenoh.Priority.REAL_TIME,
    Priority.DATA_HIGH: zenoh.Priority.DATA_HIGH,
    Priority.DATA: zenoh.Priority.DATA,
    Priority.DATA_LOW: zenoh.Priority.DATA_LOW,
    Priority.BACKGROUND: zenoh.Priority.BACKGROUND,
}
_RING, _WILDCARD_RING = 8, 64
"""Newest samples that wait for the thread that puts them away, which takes microseconds: what is replaced is replaced,
and counted, in the inbox. Behind a key expression with a wildcard many keys share one channel."""
LOG = logging.getLogger("suturegrasp.delivery")


def say_refused(key: str, named: str) -> None:
    """Say that a message came under another key than its own, for those who count no refusals."""
    LOG.warning("a message on %s was refused: %s", key, why_refused(named))


def as_told(topic: Topic, otherwise: tuple[Topic, ...]) -> Topic:
    """A row of the table as a rig has it, given the rows that the rig has otherwise."""
    return next((row for row in otherwise if str(row) == str(topic)), topic)


class RouterLinks:
    """Publishers and subscribers of one agent, as its rig has the rows of the table of topics."""

    def __init__(self, otherwise: tuple[Topic, ...] = ()) -> None:
        """`otherwise` are rows of the table as this rig has them, where it has them otherwise."""
        self._otherwise = otherwise

    def publisher(self, session: zenoh.Session, key: str, topic: Topic) -> Any:
        """A publisher of a topic that is not a command."""
        return declare_publisher(session, key, as_told(topic, self._otherwise))

    def subscribe(
        self,
        session: zenoh.Session,
        key: str,
        topic: Topic,
        receive: Callable[[zenoh.Sample], None],
        missed: Callable[[int], None],
        losses: RingLosses | None = None,
        refused: Callable[[str, str], None] = say_refused,
    ) -> list[Any]:
        """Have every sample of a topic that is not a command handed over."""
        return subscribe(session, key, as_told(topic, self._otherwise), receive, missed, losses, refused)


def ring_room(key: str) -> int:
    """How many samples wait behind a key expression of a *latest* topic."""
    return _WILDCARD_RING if "*" in key else _RING


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
    losses: RingLosses | None = None,
    refused: Callable[[str, str], None] = say_refused,
) -> list[Any]:
    """Have every sample of a topic that is not a command handed over; keep what is returned.

    `receive` is called from another thread and must only put things away. `missed` is told of lost events; `losses` are
    counted of a topic of which only the newest is wanted; `refused` is told the key under which a message came that
    names another one, and that one.
    """
    if topic.delivery is Delivery.LATEST:
        room = ring_room(key)
        subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(room))
        return [_Receiving(subscriber, key, _hand_over, receive, losses or RingLosses(room), refused)]
    is_event = topic.delivery is Delivery.EVENT
    return [LosslessSubscriber(session, key, is_event, _kept(topic), receive, missed, refused)]


def subscribe_unlooked(session: zenoh.Session, key: str, unlooked: Unlooked) -> list[Any]:
    """Have every sample of a *latest* topic wait as it came; keep what is returned."""
    subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(ring_room(key)))
    return [_Receiving(subscriber, key, _put_away, unlooked)]


def _kept(topic: Topic) -> int:
    """How many messages of a topic that must arrive are there for those who were away."""
    return topic.kept if topic.delivery is Delivery.EVENT else 1


class _Receiving:
    """A subscriber, and the thread that hands over what it hears."""

    def __init__(self, subscriber: Any, key: str, hand_over: Callable[..., None], *ways: Any) -> None:
        self._subscriber = subscriber
        taken = (subscriber.handler, *ways)
        self._thread = threading.Thread(target=hand_over, args=taken, daemon=True, name=f"receive {key}")
        self._thread.start()

    def undeclare(self) -> None:
        """End both: a thread that is still inside Zenoh when the interpreter ends aborts the process."""
        self._subscriber.undeclare()
        self._thread.join(ENDS_S)


def _hand_over(
    channel: Any,
    receive: Callable[[zenoh.Sample], None],
    losses: RingLosses,
    refused: Callable[[str, str], None],
) -> None:
    """Until the subscriber is undeclared, which ends its channel."""
    try:
        while True:
            sample = channel.recv()
            while sample is not None:
                key, attachment = str(sample.key_expr), sample.attachment
                if named := other_key(sample.encoding, key):
                    losses.taken(key, None)
                    refused(key, named)
                else:
                    losses.taken(key, unpack(attachment.to_bytes()) if attachment is not None else None)
                    receive(sample)
                sample = channel.try_recv()
            losses.emptied()
    except zenoh.ZError:
        return


def _put_away(channel: Any, unlooked: Unlooked) -> None:
    """The same for what waits as it came."""
    try:
        while True:
            sample = channel.recv()
            while sample is not None:
                unlooked.put(sample)
                sample = channel.try_recv()
            unlooked.put(None)
    except zenoh.ZError:
        return


POOL_BYTES = 1 << 26
"""Of address space; a page is used once something has been written to it. Room for 40 frames of 1.5 MB."""


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
    pool = _pool()
    try:
        # of what consumers have not let go of, nothing is taken back: then it is full
        return None if pool is None else pool.alloc(size, policy=shm.GarbageCollect())
    except zenoh.ZError:
        return None


@functools.cache
def _pool() -> Any:
    try:
        return shm.ShmProvider.default_backend(POOL_BYTES)
    except zenoh.ZError:
        return None
