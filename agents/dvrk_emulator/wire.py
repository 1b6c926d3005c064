"""How the emulated console speaks Zenoh, as either zenoh-bridge-ros2dds or rmw_zenoh would for it."""

import itertools
import os
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import zenoh
from zenoh import ext

HASHES = {
    "sensor_msgs::msg::dds_::JointState_": "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "sensor_msgs::msg::dds_::Joy_": "RIHS01_0d356c79cad3401e35ffeb75a96a96e08be3ef896b8b83841d73e890989372c5",
    "geometry_msgs::msg::dds_::PoseStamped_": "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "std_msgs::msg::dds_::String_": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs::msg::dds_::Float64_": "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    "std_msgs::msg::dds_::Bool_": "RIHS01_feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    "std_msgs::msg::dds_::Empty_": "RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "crtk_msgs::msg::dds_::OperatingState_": "RIHS01_5cc57eea589b217fe5194bf2735b91d4a7f2dd5ac1245ae657f7ea7590c2c80e",
    "crtk_msgs::msg::dds_::StringStamped_": "RIHS01_83efb802e6596e03f69ac322e3231037329946f2bd13ed48874d97f5b8f5db1d",
}
"""As ROS Jazzy names these types in keys."""
GID = 16


class Outlet(NamedTuple):
    """A topic to publish on.

    Fields:
        wanted: whether somebody subscribes, or will get what is latched.
        put: publishes bytes, given the time.
    """

    wanted: Callable[[], bool]
    put: Callable[[bytes, int], None]


class Wire(Protocol):
    """Topics on a session."""

    def publish(self, topic: str, kind: str, latched: bool) -> Outlet:
        """A topic to publish on."""
        ...

    def subscribe(self, topic: str, kind: str, receive: Callable[[bytes], None]) -> None:
        """Have what comes on a topic handed over."""
        ...

    def close(self) -> None:
        """Undeclare everything."""
        ...


class BridgeWire:
    """As zenoh-bridge-ros2dds: a key is the topic's name, and it looks for Zenoh's own subscribers."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session, self._kept = session, list[Any]()

    def publish(self, topic: str, kind: str, latched: bool) -> Outlet:  # noqa: ARG002
        """What publishes on a topic."""
        if latched:
            cached = _latched(self._session, topic)
            self._kept.append(cached)
            return Outlet(lambda: True, lambda data, _: cached.put(data))
        publisher = self._session.declare_publisher(topic, congestion_control=zenoh.CongestionControl.DROP)
        self._kept.append(publisher)

        def wanted() -> bool:
            return publisher.matching_status.matching  # pyright: ignore[reportAttributeAccessIssue] its stub says bool

        return Outlet(wanted, lambda data, _: publisher.put(data))

    def subscribe(self, topic: str, kind: str, receive: Callable[[bytes], None]) -> None:  # noqa: ARG002
        """Hear a topic."""
        self._kept.append(self._session.declare_subscriber(topic, lambda sample: receive(sample.payload.to_bytes())))

    def close(self) -> None:
        """Undeclare everything."""
        for one in self._kept:
            one.undeclare()


class RmwWire:
    """As rmw_zenoh: keys name type and hash, tokens announce each end, and subscribers are counted by their tokens."""

    def __init__(self, session: zenoh.Session, domain: int, hashed: bool = True) -> None:
        self._session, self._domain, self._hashed = session, domain, hashed
        self._kept, self._entities, self._gid = list[Any](), itertools.count(1), os.urandom(GID)
        self._token("NN", 0, "")

    def publish(self, topic: str, kind: str, latched: bool) -> Outlet:
        """What publishes on a topic."""
        key, there, numbers = self._key(topic, kind), set[str](), itertools.count(1)
        self._token(
            "MP", next(self._entities), self._described(topic, kind, ":1:,1:,:,:,," if latched else "::,10:,:,:,,")
        )

        def count(sample: zenoh.Sample) -> None:
            change = there.add if sample.kind == zenoh.SampleKind.PUT else there.discard
            change(str(sample.key_expr))

        if latched:
            publisher: Any = _latched(self._session, key)
        else:
            publisher = self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
            listeners = f"@ros2_lv/{self._domain}/*/*/*/MS/*/*/*/{self._described(topic, kind, '*')}"
            self._kept.append(self._session.liveliness().declare_subscriber(listeners, count, history=True))
        self._kept.append(publisher)

        def put(data: bytes, now_ns: int) -> None:
            beside = next(numbers).to_bytes(8, "little") + now_ns.to_bytes(8, "little") + bytes([GID]) + self._gid
            publisher.put(data, attachment=beside)

        return Outlet(lambda: latched or bool(there), put)

    def subscribe(self, topic: str, kind: str, receive: Callable[[bytes], None]) -> None:
        """Hear a topic; what comes without its attachment is no message of rmw_zenoh."""

        def hear(sample: zenoh.Sample) -> None:
            beside = sample.attachment.to_bytes() if sample.attachment is not None else b""
            if len(beside) == 17 + GID and beside[16] == GID:
                receive(sample.payload.to_bytes())

        self._token("MS", next(self._entities), self._described(topic, kind, "::,10:,:,:,,"))
        self._kept.append(self._session.declare_subscriber(self._key(topic, kind), hear))

    def close(self) -> None:
        """Undeclare everything."""
        for one in self._kept:
            one.undeclare()

    def _token(self, role: str, entity: int, described: str) -> None:
        who = f"@ros2_lv/{self._domain}/{self._session.zid()}/0/{entity}/{role}/%/%/dvrk"
        token = f"{who}/{described}" if described else who
        self._kept.append(self._session.liveliness().declare_token(token))

    def _key(self, topic: str, kind: str) -> str:
        return f"{self._domain}/{topic}/{kind}/{self._hash(kind)}"

    def _described(self, topic: str, kind: str, qos: str) -> str:
        return f"%{topic.replace('/', '%')}/{kind}/{self._hash(kind)}/{qos}"

    def _hash(self, kind: str) -> str:
        return HASHES[kind] if self._hashed else "TypeHashNotSupported"


def _latched(session: zenoh.Session, key: str) -> Any:
    """A publisher whose last message reaches those who come later."""
    return ext.declare_advanced_publisher(
        session,
        key,
        cache=ext.CacheConfig(1),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
        publisher_detection=True,
    )
