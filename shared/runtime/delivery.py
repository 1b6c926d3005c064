"""How each delivery class is built on Zenoh (see Delivery in schemas/topics.py)."""

import logging
import threading
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh import ext

from schemas.codec import encoded_parts
from schemas.topics import Delivery, Priority, Topic
from shared.runtime.accounts import RingLosses
from shared.runtime.attachment import unpack
from shared.runtime.lossless import LosslessSubscriber
from shared.runtime.own_key import encoding_of, other_key, why_refused
from shared.runtime.shared_memory import joined
from shared.runtime.unlooked import Unlooked

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
    """The ways of one agent's messages: all of them by the router."""

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

    def close(self) -> None:
        """Nothing is held here."""


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
