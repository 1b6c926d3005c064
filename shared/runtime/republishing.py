"""Publishing a recording again on a rig's live keys, in the place of the agents that it came from.

Whoever does so stands for those agents: their tokens are declared, so that none of them is started meanwhile, and none
that runs is spoken over. Numbers begin anew: an epoch of one's own, and no gaps but those that this journey makes.
"""

import contextlib
import os
import threading
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from typing import Any

import zenoh

from schemas.codec import encode
from schemas.messages import CommandAnswer, Progress, ReplayClock
from schemas.topics import MAIN, REPLAY_CLOCK, Topic, key, key_root, topic_of
from shared.clock import now_ns
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import ROUTER_WAIT_S, Connection, open_when_there
from shared.runtime.delivery import as_told, declare_publisher
from shared.runtime.facts import ask_progress
from shared.runtime.session import SessionSettings

REPLAY = REPLAY_CLOCK.agent


class Republisher(Connection):
    """Publishes messages as they were recorded; `epoch` is that of all of them."""

    def __init__(self, session: zenoh.Session, settings: SessionSettings, waits: bool) -> None:
        """`waits` for the network where it is too slow, so that nothing is dropped on its way."""
        super().__init__(session, settings)
        self.epoch = int.from_bytes(os.urandom(7), "big")
        self._waits = waits
        self._publishers: dict[str, Any] = {}
        self._sent: dict[str, int] = {}
        # the time is told from more than one thread
        self._telling = threading.Lock()

    @contextmanager
    def hearing(self, keys: Iterable[str]) -> Generator[set[str]]:
        """Those of some keys on which something is published meanwhile: a set that fills."""
        heard: set[str] = set()
        listening = [self._session.declare_subscriber(k, lambda sample: heard.add(str(sample.key_expr))) for k in keys]
        try:
            yield heard
        finally:
            for subscriber in listening:
                subscriber.undeclare()

    def stand_for(self, keys: Iterable[str]) -> None:
        """Declare these keys one's own: publishers of all, and the tokens of the agents whose they are."""
        owners = {(REPLAY, MAIN)}
        for name in (*keys, key(self._rig, REPLAY_CLOCK)):
            topic = as_told(topic_of(name), self._otherwise)
            self._publishers[name] = declare_publisher(self._session, name, topic, self._waits)
            self._sent[name] = 0
            owners.add((name.split("/")[2], name.split("/")[3]))
        for kind, instance in sorted(owners):
            token = self._session.liveliness().declare_token(key_root(self._rig, instance, kind))
            self._kept.append(token)

    def publish(self, name: str, payload: bytes, published_ns: int) -> int:
        """Publish a message on one of these keys; its number there."""
        number = self._sent[name]
        self._publishers[name].put(payload, attachment=pack(Attachment(self.epoch, number, published_ns, 0.0)))
        self._sent[name] = number + 1
        return number

    def tell_time(self, replayed_ns: int, rate: float) -> None:
        """Say which time it is in the recording, and how fast that goes on."""
        with self._telling:
            self.publish(key(self._rig, REPLAY_CLOCK), encode(ReplayClock(replayed_ns, rate)), now_ns())

    def send(self, topic: Topic, instance: str, message: Any) -> CommandAnswer:
        """Send a command; its answer."""
        return self.command(topic, message, instance)

    def progress(self) -> dict[str, Progress]:
        """How far every consumer has got, as `kind/instance`."""
        return ask_progress(self._session, self._rig)

    def close(self) -> None:
        """Speak for nobody any more."""
        for publisher in self._publishers.values():
            publisher.undeclare()
        self._publishers = {}
        super().close()


@contextmanager
def republishing(
    settings: SessionSettings, waits: bool = False, within_s: float = ROUTER_WAIT_S
) -> Generator[Republisher]:
    """A connection to a rig, on which a recording can be published.

    Raises:
        NoRouterError: where no router answers in time.
    """
    with (
        open_when_there(settings, within_s) as session,
        contextlib.closing(Republisher(session, settings, waits)) as republisher,
    ):
        yield republisher
