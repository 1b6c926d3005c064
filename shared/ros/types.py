"""The ROS 2 message types that this project reads and writes, and their CDR form.

CDR (OMG DDS-XTypes) is written by rosbags in little endian with the four bytes that say so in front, which is what
both zenoh-bridge-ros2dds and rmw_zenoh carry. crtk_msgs are those of collaborative-robotics/crtk_msgs.
"""

import functools
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
OPERATING_STATE = "crtk_msgs/msg/OperatingState"
STRING_STAMPED = "crtk_msgs/msg/StringStamped"
STRING = "std_msgs/msg/String"
BOOL = "std_msgs/msg/Bool"
EMPTY = "std_msgs/msg/Empty"
FLOAT64 = "std_msgs/msg/Float64"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
JOY = "sensor_msgs/msg/Joy"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

HEADER_BYTES = 4
LITTLE_ENDIAN = b"\x00\x01\x00\x00"

_CRTK = {
    OPERATING_STATE: "std_msgs/Header header\nstring state\nbool is_homed\nbool is_busy\n",
    STRING_STAMPED: "std_msgs/Header header\nstring string\n",
}


class RosMessageError(ValueError):
    """Bytes that are not the message they should be; the text says which."""


@functools.cache
def store() -> Typestore:
    """All known types; loading them takes a tenth of a second."""
    known = get_typestore(Stores.ROS2_HUMBLE)
    for name, definition in _CRTK.items():
        known.register(get_types_from_msg(definition, name))
    return known


def message(name: str, *fields: Any) -> Any:
    """A message of a type from its fields in their order."""
    return store().types[name](*fields)


def encode(name: str, content: Any) -> bytes:
    """A message as CDR."""
    return bytes(store().serialize_cdr(content, name))


def decode(name: str, data: bytes) -> Any:
    """A message from CDR.

    Raises:
        RosMessageError: where the bytes are none of that type, or are cut off.
    """
    if len(data) < HEADER_BYTES:
        raise RosMessageError(f"{len(data)} bytes are no {name}")
    try:
        return store().deserialize_cdr(data, name)
    except Exception as error:
        # generated code raises whatever the bytes lead it to
        raise RosMessageError(f"{len(data)} bytes are no {name}: {type(error).__name__}") from error


@functools.cache
def type_hash(name: str) -> str:
    """The hash of a type's definition (REP 2016), by which rmw_zenoh tells publishers and subscribers that fit."""
    return store().hash_rihs01(name)
