"""ROS topics on a Zenoh session of their own: heard, said, and who else says them.

The session is opened in the background, and waits for the router that the robot's computer has; until then nothing is
heard, and what is said goes nowhere. It is apart from that of the rig: the robot's keys never cross the rig's router.
"""

import itertools
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


@dataclass(frozen=True)
class Heard:
    """A topic to hear.

    Fields:
        receive: is given the payload and when it came, from another thread, and must return at once.
        latched: whether the last message reaches those who come later.
        others_only: leave out what this very link says.
    """

    topic: str
    ros_type: str
    receive: Callable[[bytes, int], None]
    latched: bool = False
    others_only: bool = False


@dataclass
class Said:
    """A topic to speak on."""

    topic: str
    ros_type: str
    sequence: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))
    publisher: Any = None


class RosLink:
    """Hears and says ROS topics, from `open` until `close`.

    Fields:
        failed: why there will be no session; empty while there is one, or may be.

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
        self.failed = ""
        self._gid, self._session, self._kept = os.urandom(GID_BYTES), None, []
        self._stopped, self._thread = threading.Event(), threading.Thread(target=self._run, name="ros", daemon=True)

    def open(self) -> None:
        """Begin to connect; the second time nothing happens."""
        if not self._thread.ident:
            self._thread.start()

    def say(self, topic: str, payload: bytes) -> None:
        """Publish on one of the topics to speak on; what the network does not take now is dropped."""
        said = self._said[topic]
        if said.publisher is not None:
            said.publisher.put(payload, attachment=self._naming.attachment(next(said.sequence), now_ns(), self._gid))

    def reaches(self) -> bool:
        """Whether the Zenoh of the other end is connected now."""
        session = self._session
        return session is not None and bool(session.info.routers_zid() or session.info.peers_zid())

    def close(self) -> None:
        """Say and hear nothing more."""
        self._stopped.set()
        if self._thread.ident:
            self._thread.join(ENDS_S)
        session, self._session = self._session, None
        for said in self._said.values():
            said.publisher = None
        if session is not None:
            for declared in self._kept:
                declared.undeclare()
            session.close()

    def _run(self) -> None:
        try:
            session = open_when_there(self._settings, stopped=self._stopped)
        except (NoRouterError, IdentityError) as error:
            self.failed = str(error)
            return
        self._session = session
        self._announce(session)
        for said in self._said.values():
            said.publisher = session.declare_publisher(
                self._naming.key(said.topic, said.ros_type),
                # what cannot go now must not go later
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
            self._kept.append(said.publisher)
        # only then, so that whoever has heard something can speak
        for wanted in self._heard:
            self._kept.append(_subscribed(session, self._naming, wanted))

    def _announce(self, session: zenoh.Session) -> None:
        """Tell ROS who is here, and hear of others who would command."""
        who, own, token = str(session.zid()), set[str](), self._naming.token
        roles = [
            (Role.NODE, "", "", False),
            *((Role.SUBSCRIBER, one.topic, one.ros_type, one.latched) for one in self._heard),
            *((Role.PUBLISHER, one.topic, one.ros_type, False) for one in self._said.values()),
        ]
        for entity, role in enumerate(roles):
            if announced := token(who, entity, *role):
                own.add(announced)
                self._kept.append(session.liveliness().declare_token(announced))

        def hear(sample: zenoh.Sample) -> None:
            if (found := str(sample.key_expr)) not in own:
                self._owner_changed(found, sample.kind == zenoh.SampleKind.PUT)

        for topic in self._watched:
            selector = self._naming.publishers(topic)
            self._kept.append(session.liveliness().declare_subscriber(selector, hear, history=True))


def _subscribed(session: zenoh.Session, naming: Naming, wanted: Heard) -> Any:
    def hear(sample: zenoh.Sample) -> None:
        wanted.receive(sample.payload.to_bytes(), now_ns())

    selector = naming.selector(wanted.topic, wanted.ros_type)
    origin = zenoh.Locality.REMOTE if wanted.others_only else zenoh.Locality.ANY
    if not wanted.latched:
        return session.declare_subscriber(selector, hear, allowed_origin=origin)
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    return ext.declare_advanced_subscriber(session, selector, hear, history=history, allowed_origin=origin)
