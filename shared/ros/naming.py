"""Under which Zenoh keys ROS topics go: by zenoh-bridge-ros2dds, or by rmw_zenoh itself.

A topic is written as ROS does without the leading slash, `PSM1/measured_js`; a type as `sensor_msgs/msg/JointState`.

- `ros2dds`: the key is the topic; nothing travels beside the payload, and no announcements are needed.
- `rmw_zenoh`: the key names domain, type and hash as well; an attachment of 33 bytes numbers and dates each message;
  nodes, publishers and subscribers announce themselves by liveliness tokens, from which ROS counts who listens.

Sources: eclipse-zenoh/zenoh-plugin-ros2dds (liveliness_mgt.rs), ros2/rmw_zenoh (docs/design.md, liveliness_utils).
"""

import enum
import struct
from dataclasses import dataclass
from typing import Protocol

from shared.ros.types import type_hash

NODE, GUARD_NODE = "suturegrasp", "suturegrasp_guard"
NO_HASH = "TypeHashNotSupported"
"""What stands in place of a type's hash in ROS Humble."""
GID_BYTES = 16
_ATTACHMENT = struct.Struct("<qqB16s")
_QOS = {False: "::,10:,:,:,,", True: ":1:,1:,:,:,,"}
"""Reliable, keep the last few; with durability 1, transient local, where latched."""


class Role(enum.Enum):
    """What announces itself."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIBER = "MS"


class Naming(Protocol):
    """One way of carrying ROS topics."""

    def key(self, topic: str, ros_type: str) -> str:
        """The key to publish a topic under."""
        ...

    def selector(self, topic: str, ros_type: str) -> str:
        """The key expression to hear a topic by, whatever version of its type it is of."""
        ...

    def attachment(self, sequence: int, now_ns: int, gid: bytes) -> bytes | None:
        """What travels beside a payload; None for nothing."""
        ...

    def token(self, session: str, entity: int, role: Role, topic: str, ros_type: str, latched: bool) -> str | None:
        """The liveliness token of a node, publisher or subscriber of ours; None where none is needed."""
        ...

    def publishers(self, topic: str) -> str:
        """The key expression that matches the liveliness tokens of all publishers of a topic."""
        ...


@dataclass(frozen=True)
class Ros2dds:
    """As zenoh-bridge-ros2dds names topics."""

    def key(self, topic: str, ros_type: str) -> str:  # noqa: ARG002
        """The topic itself."""
        return topic

    def selector(self, topic: str, ros_type: str) -> str:
        """The topic itself."""
        return self.key(topic, ros_type)

    def attachment(self, sequence: int, now_ns: int, gid: bytes) -> bytes | None:  # noqa: ARG002
        """Nothing."""
        return None

    def token(self, session: str, entity: int, role: Role, topic: str, ros_type: str, latched: bool) -> str | None:  # noqa: ARG002
        """None: the bridge looks for Zenoh's own subscribers."""
        return None

    def publishers(self, topic: str) -> str:
        """Those that a bridge has found on its side, in DDS."""
        return f"@/*/@ros2_lv/MP/{topic.replace('/', '§')}/**"


@dataclass(frozen=True)
class RmwZenoh:
    """As rmw_zenoh names topics.

    Fields:
        domain: ROS_DOMAIN_ID.
        hashed: whether keys name the hash of a type, as from ROS Iron on; in Humble they do not.
        node: what our node is called.
    """

    domain: int = 0
    hashed: bool = True
    node: str = NODE

    def key(self, topic: str, ros_type: str) -> str:
        """Domain, topic, type and hash."""
        return f"{self.domain}/{topic}/{_dds(ros_type)}/{self._hash(ros_type)}"

    def selector(self, topic: str, ros_type: str) -> str:
        """The same of any hash: what cannot be read as the type is refused where it is read."""
        return f"{self.domain}/{topic}/{_dds(ros_type)}/*"

    def attachment(self, sequence: int, now_ns: int, gid: bytes) -> bytes | None:
        """Sequence number, time, and the publisher's id with its length."""
        return _ATTACHMENT.pack(sequence, now_ns, GID_BYTES, gid)

    def token(self, session: str, entity: int, role: Role, topic: str, ros_type: str, latched: bool) -> str | None:
        """Who it is and what of; entity 0 is the node."""
        head = f"@ros2_lv/{self.domain}/{session}/0/{entity}/{role.value}/%/%/{self.node}"
        if role is Role.NODE:
            return head
        return f"{head}/%{topic.replace('/', '%')}/{_dds(ros_type)}/{self._hash(ros_type)}/{_QOS[latched]}"

    def publishers(self, topic: str) -> str:
        """Those of any node."""
        return f"@ros2_lv/{self.domain}/*/*/*/MP/*/*/*/%{topic.replace('/', '%')}/*/*/*"

    def _hash(self, ros_type: str) -> str:
        return type_hash(ros_type) if self.hashed else NO_HASH


def _dds(ros_type: str) -> str:
    package, kind, name = ros_type.split("/")
    return f"{package}::{kind}::dds_::{name}_"
