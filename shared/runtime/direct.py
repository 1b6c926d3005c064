"""A direct link between agents of one user on one host, past the router, for images.

Each publisher of images listens on a Unix socket in a folder that only its user may enter; consumers connect there with
a second session, and hear the same topic through the router whenever that link is missing. No rule of a router sees
what goes over such a link: hence one host, one user, and only where the rig asks for it.
"""

import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh

from schemas.topics import FRAMES, MAIN, Topic
from shared.runtime.accounts import RingLosses
from shared.runtime.attachment import unpack
from shared.runtime.delivery import RouterLinks, as_told, declare_publisher, ring_room, say_refused, subscribe
from shared.runtime.session import opened

SOCKETS_MODE = 0o700
ENDS_S = 5.0
ALIVE = "direct"
"""Last part of the key of a token that stands as long as the link does."""


def socket_endpoint(folder: Path, kind: str, instance: str) -> str:
    """Where an agent's direct session listens; the folder is made where it is missing, for this user alone."""
    folder.mkdir(mode=SOCKETS_MODE, parents=True, exist_ok=True)
    folder.chmod(SOCKETS_MODE)
    return f"unixsock-stream/{folder}/{kind}.{instance}.sock"


def open_direct_publishing(endpoint: str) -> zenoh.Session:
    """A session that consumers connect to; it knows no router."""
    return opened(_direct_settings(listen=[endpoint]))


def open_direct_consuming(endpoints: list[str]) -> zenoh.Session:
    """A session that is linked with those of the endpoints that are there, and with the others once they come."""
    return opened(_direct_settings(connect=endpoints))


def _direct_settings(listen: list[str] | None = None, connect: list[str] | None = None) -> dict[str, Any]:
    return {
        "mode": "peer",
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        "listen/endpoints": listen or [],
        "connect/endpoints": connect or [],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
    }


class DirectLinks(RouterLinks):
    """The ways of one agent's messages: frames by a direct link where both ends have one, all else by the router."""

    def __init__(self, folder: Path, kind: str, instance: str, otherwise: tuple[Topic, ...] = ()) -> None:
        super().__init__(otherwise)
        self._folder, self._own = folder, (kind, instance)
        self._sessions: list[zenoh.Session] = []

    def publisher(self, session: zenoh.Session, key: str, topic: Topic) -> Any:
        """A publisher of a topic that is not a command, as `delivery.declare_publisher` makes it."""
        if topic is not FRAMES:
            return super().publisher(session, key, topic)
        direct = open_direct_publishing(socket_endpoint(self._folder, *self._own))
        self._sessions.append(direct)
        return DirectPublisher(session, direct, key, as_told(topic, self._otherwise))

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
        """Have every sample handed over once, as `delivery.subscribe` does."""
        if topic is not FRAMES:
            return super().subscribe(session, key, topic, receive, missed, losses, refused)
        direct = open_direct_consuming([socket_endpoint(self._folder, topic.agent, MAIN)])
        self._sessions.append(direct)
        return subscribe_directly(session, direct, key, topic, receive, losses, refused)

    def close(self) -> None:
        """End the sessions of the direct links, once nothing is declared on them."""
        for session in self._sessions:
            session.close()
        self._sessions = []


class DirectPublisher:
    """Publishes a *latest* topic by both ways; Zenoh sends by neither where nobody listens."""

    def __init__(self, session: zenoh.Session, direct: zenoh.Session, key: str, topic: Topic) -> None:
        self._by_router = declare_publisher(session, key, topic)
        self._direct = declare_publisher(direct, key, topic)
        self._token = direct.liveliness().declare_token(f"{key}/{ALIVE}")

    def put(self, payload: Any, attachment: bytes) -> None:
        """Publish a payload, of which both ways hold the same copy."""
        shared = zenoh.ZBytes(payload)
        self._direct.put(shared, attachment=attachment)
        self._by_router.put(shared, attachment=attachment)

    def undeclare(self) -> None:
        """End both ways."""
        for declared in (self._token, self._direct, self._by_router):
            declared.undeclare()


def subscribe_directly(
    session: zenoh.Session,
    direct: zenoh.Session,
    key: str,
    topic: Topic,
    receive: Callable[[zenoh.Sample], None],
    losses: RingLosses | None = None,
    refused: Callable[[str, str], None] = say_refused,
) -> list[Any]:
    """Have every sample of a *latest* topic handed over once, by the direct link where it is there; keep what returns.

    `receive` is called from other threads, one at a time, and must only put things away.
    """
    once = _Once(receive, losses or RingLosses(ring_room(key)))
    ways = _Ways(session, key, topic, once, refused)
    by_link = subscribe(direct, key, topic, ways.heard_directly, _unmissed, once.ring(), refused)
    alive = direct.liveliness().declare_subscriber(f"{key}/{ALIVE}", ways.link_changed, history=True)
    return [alive, *by_link, ways]


def _unmissed(_: int) -> None:
    """Of newest messages, the ring alone tells what was lost."""


class _Once:
    """Hands over each sample the first time that it comes, and none that is older than one before."""

    def __init__(self, receive: Callable[[zenoh.Sample], None], losses: RingLosses) -> None:
        self._receive, self._losses, self._lock = receive, losses, threading.Lock()
        self._last: dict[str, tuple[int, int]] = {}

    def __call__(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        beside = unpack(sample.attachment.to_bytes()) if sample.attachment is not None else None
        with self._lock:
            if beside is not None:
                epoch, sequence = self._last.get(key, (beside.epoch, -1))
                if epoch == beside.epoch and beside.sequence <= sequence:
                    return
                self._last[key] = (beside.epoch, beside.sequence)
            self._losses.taken(key, beside)
            self._receive(sample)

    def ring(self) -> RingLosses:
        """What one of the ways tells its losses to."""
        return _OneOfTheWays(self._losses, self._lock)


class _OneOfTheWays(RingLosses):
    """Counts nothing by itself: what one way has left out may have come by the other."""

    def __init__(self, losses: RingLosses, lock: threading.Lock) -> None:
        super().__init__(losses.room)
        self._both, self._lock = losses, lock

    def taken(self, key: str, beside: Any) -> None:
        pass

    def emptied(self) -> None:
        with self._lock:
            self._both.emptied()


class _Ways:
    """Listens through the router while nothing comes by the link, from a thread of its own.

    Zenoh's own threads must not declare anything, and a link that is announced has not carried anything yet.
    """

    def __init__(
        self, session: zenoh.Session, key: str, topic: Topic, once: _Once, refused: Callable[[str, str], None]
    ) -> None:
        self._listened = session, key, topic, once, _unmissed
        self._once, self._refused = once, refused
        self._by_router: list[Any] = []
        self._announced = self._carries = False
        self._changing = threading.Lock()
        self._wanted: queue.Queue[bool | None] = queue.Queue()
        self._listen(True)
        self._thread = threading.Thread(target=self._follow, name=f"ways of {key}", daemon=True)
        self._thread.start()

    def heard_directly(self, sample: zenoh.Sample) -> None:
        with self._changing:
            # what is put away after the link has ended says nothing about the link
            if self._announced and not self._carries:
                self._carries = True
                self._wanted.put(False)
        self._once(sample)

    def link_changed(self, sample: zenoh.Sample) -> None:
        with self._changing:
            self._announced, self._carries = sample.kind == zenoh.SampleKind.PUT, False
            if not self._announced:
                self._wanted.put(True)

    def undeclare(self) -> None:
        self._wanted.put(None)
        self._thread.join(ENDS_S)

    def _follow(self) -> None:
        while (wanted := self._wanted.get()) is not None:
            self._listen(wanted)
        self._listen(False)

    def _listen(self, wanted: bool) -> None:
        if wanted and not self._by_router:
            self._by_router = subscribe(*self._listened, self._once.ring(), self._refused)
        elif not wanted:
            for declared in self._by_router:
                declared.undeclare()
            self._by_router = []
