"""ROS topics on a Zenoh session of their own: heard, said, and who else says them.

The session is opened in the background, and waits for the router that the robot's computer has; until then nothing is
heard, and what is said goes nowhere. It is apart from that of the rig: the robot's keys never cross the rig's router.

A session whose link broke is not used again: Zenoh has taken one key for another after that (docs/decisions.md, 29),
and what a console says does not name its key. Nothing more of it is heard, and another one is opened.
"""

import contextlib
import itertools
import logging
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zenoh
from zenoh import ext

from shared.clock import now_ns
from shared.ros.naming import GID_BYTES, Naming, Role
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.identity import IdentityError
from shared.runtime.session import SessionSettings

ENDS_S = 5.0
LOG = logging.getLogger("suturegrasp.ros")


@dataclass(frozen=True)
class Heard:
    """A topic to hear.

    Fields:
        receive: is given the payload and when it came, from another thread, and must return at once.
        latched: whether the last message reaches those who come later.
        others_only: leave out what this very link says.
        plain: the topic itself is the key, and nothing of ROS is about it.
    """

    topic: str
    ros_type: str
    receive: Callable[[bytes, int], None]
    latched: bool = False
    others_only: bool = False
    plain: bool = False


@dataclass
class Said:
    """A topic to speak on; `plain` as for what is heard."""

    topic: str
    ros_type: str
    plain: bool = False
    sequence: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))
    publisher: Any = None


class RosLink:
    """Hears and says ROS topics, from `open` until `close`.

    Fields:
        failed: why there will be no session; empty while there is one, or may be.
        broken: how often the link to the robot's Zenoh was lost.

    Args:
        owner_changed: is told of each publisher of `watched` topics, other than this link, that comes (True) or goes.
    """

    def __init__(
        self,
        settings: SessionSettings,
        naming: Naming,
        heard: tuple[Heard, ...],
        said: tuple[Said, ...] = (),
        watched: tuple[str, ...] = (),
        owner_changed: Callable[[str, bool], None] = lambda _token, _comes: None,
    ) -> None:
        self._settings, self._naming, self._heard = settings, naming, heard
        self._said = {one.topic: one for one in said}
        self._watched, self._owner_changed = watched, owner_changed
        self.failed, self.broken = "", 0
        self._gid, self._session, self._kept = os.urandom(GID_BYTES), None, list[Any]()
        self._stopped, self._thread = threading.Event(), threading.Thread(target=self._run, name="ros", daemon=True)
        self._lost, self._complained = threading.Event(), False
        self._owners = set[str]()

    def open(self) -> None:
        """Begin to connect; the second time nothing happens."""
        if not self._thread.ident:
            self._thread.start()

    def say(self, topic: str, payload: bytes) -> bool:
        """Publish on one of the topics to speak on; what the network does not take now is dropped.

        False where it could not be handed over: no error of the network's keeps whoever says hold from going on.
        """
        said = self._said.get(topic)
        publisher = None if said is None else said.publisher
        if said is None or publisher is None:
            return False
        beside = None if said.plain else self._naming.attachment(next(said.sequence), now_ns(), self._gid)
        try:
            publisher.put(payload, attachment=beside)
        except zenoh.ZError as error:
            if not self._complained:
                LOG.warning("%s could not be said: %s", topic, error)
            self._complained = True
            return False
        return True

    def reaches(self) -> bool:
        """Whether the Zenoh of the other end is connected now."""
        session = self._session
        return session is not None and bool(session.info.routers_zid() or session.info.peers_zid())

    def close(self) -> None:
        """Say and hear nothing more."""
        self._stopped.set()
        self._lost.set()
        if self._thread.ident:
            self._thread.join(ENDS_S)
        session = self._let_go()
        if session is not None:
            session.close()

    def _let_go(self) -> Any:
        """The session, of which nothing is used any more."""
        session, self._session = self._session, None
        kept, self._kept = self._kept, []
        for said in self._said.values():
            said.publisher = None
        for declared in kept:
            # of a link that broke nothing can be undeclared any more
            with contextlib.suppress(zenoh.ZError):
                declared.undeclare()
        return session

    def _run(self) -> None:
        while not self._stopped.is_set():
            try:
                session = open_when_there(self._settings, stopped=self._stopped)
            except (NoRouterError, IdentityError) as error:
                self.failed = str(error)
                return
            self._lost = threading.Event()
            self._use(session, self._lost)
            self._lost.wait()
            if self._stopped.is_set():
                return
            self.broken += 1
            lost = self._let_go()
            # who else is there, the next session tells
            for token in tuple(self._owners):
                self._owner(token, comes=False)
            # closing a session whose other end is gone can take long
            threading.Thread(target=lost.close, name="lost", daemon=True).start()

    def _use(self, session: zenoh.Session, lost: threading.Event) -> None:
        """Hear and speak on a session until it is lost."""

        def changed(event: Any) -> None:
            if event.kind == zenoh.SampleKind.DELETE:
                lost.set()

        self._kept.append(session.info.declare_transport_events_listener(changed))
        self._session = session
        self._announce(session, lost)
        for said in self._said.values():
            said.publisher = session.declare_publisher(
                said.topic if said.plain else self._naming.key(said.topic, said.ros_type),
                # what cannot go now must not go later
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
            self._kept.append(said.publisher)
        # only then, so that whoever has heard something can speak
        for wanted in self._heard:
            self._kept.append(_subscribed(session, self._naming, wanted, lost))

    def _announce(self, session: zenoh.Session, lost: threading.Event) -> None:
        """Tell ROS who is here, and hear of others who would command."""
        who, own, token = str(session.zid()), set[str](), self._naming.token
        roles = [
            (Role.NODE, "", "", False),
            *((Role.SUBSCRIBER, one.topic, one.ros_type, one.latched) for one in self._heard if not one.plain),
            *((Role.PUBLISHER, one.topic, one.ros_type, False) for one in self._said.values() if not one.plain),
        ]
        for entity, role in enumerate(roles):
            if announced := token(who, entity, *role):
                own.add(announced)
                self._kept.append(session.liveliness().declare_token(announced))

        def hear(sample: zenoh.Sample) -> None:
            if (found := str(sample.key_expr)) not in own and not lost.is_set():
                self._owner(found, comes=sample.kind == zenoh.SampleKind.PUT)

        for topic in self._watched:
            selector = self._naming.publishers(topic)
            self._kept.append(session.liveliness().declare_subscriber(selector, hear, history=True))

    def _owner(self, token: str, comes: bool) -> None:
        (self._owners.add if comes else self._owners.discard)(token)
        self._owner_changed(token, comes)


def _subscribed(session: zenoh.Session, naming: Naming, wanted: Heard, lost: threading.Event) -> Any:
    def hear(sample: zenoh.Sample) -> None:
        if not lost.is_set():
            wanted.receive(sample.payload.to_bytes(), now_ns())

    selector = wanted.topic if wanted.plain else naming.selector(wanted.topic, wanted.ros_type)
    origin = zenoh.Locality.REMOTE if wanted.others_only else zenoh.Locality.ANY
    if not wanted.latched:
        return session.declare_subscriber(selector, hear, allowed_origin=origin)
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    return ext.declare_advanced_subscriber(session, selector, hear, history=history, allowed_origin=origin)
