"""What is said to and heard from an arm that speaks CRTK, as values; checked once, where it enters.

Joints in radians and metres, poses in metres, stamps in nanoseconds of the robot's own clock.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from shared.rigid_transforms import quaternion_from_rotation, rotation_from_quaternion, transform
from shared.ros.types import (
    BOOL,
    EMPTY,
    FLOAT64,
    JOINT_STATE,
    JOY,
    OPERATING_STATE,
    POSE_STAMPED,
    STRING,
    STRING_STAMPED,
    RosMessageError,
    decode,
    encode,
    message,
)

SECOND_NS = 1_000_000_000
_UNIT_TOLERANCE = 1e-3


class Joints(NamedTuple):
    """Positions of joints, and when they were measured; efforts where the message has them."""

    stamp_ns: int
    position: Float64[np.ndarray, "n"]
    effort: Float64[np.ndarray, "m"]


class Pose(NamedTuple):
    """A pose, in which frame, and when it was measured."""

    stamp_ns: int
    frame: str
    T: Float64[np.ndarray, "4 4"]


class OperatingState(NamedTuple):
    """Whether an arm takes commands: `state` is DISABLED, ENABLED, PAUSED or FAULT."""

    state: str
    is_homed: bool
    is_busy: bool


def joint_command(position: Float64[np.ndarray, "n"], stamp_ns: int) -> bytes:
    """Positions for joints (sensor_msgs/JointState), without names, velocities and efforts.

    Raises:
        ValueError: where there are none, or one is not finite; consoles take neither well.
    """
    position = np.asarray(position, np.float64).ravel()
    if not position.size or not np.isfinite(position).all():
        raise ValueError("a command for joints needs positions, all of them finite")
    nothing = np.zeros(0)
    return encode(JOINT_STATE, message(JOINT_STATE, _header(stamp_ns), [], position, nothing, nothing))


def pose_command(T: Float64[np.ndarray, "4 4"], stamp_ns: int) -> bytes:
    """A pose for the tool (geometry_msgs/PoseStamped).

    Raises:
        ValueError: where it is not finite.
    """
    if not np.isfinite(T).all():
        raise ValueError("a command for a pose needs one that is finite")
    w, x, y, z = (float(value) for value in quaternion_from_rotation(T[:3, :3]))
    at = message("geometry_msgs/msg/Point", *(float(value) for value in T[:3, 3]))
    pose = message("geometry_msgs/msg/Pose", at, message("geometry_msgs/msg/Quaternion", x, y, z, w))
    return encode(POSE_STAMPED, message(POSE_STAMPED, _header(stamp_ns), pose))


def ratio(share: float) -> bytes:
    """The share of full speed that a console's own trajectories have (std_msgs/Float64)."""
    return encode(FLOAT64, message(FLOAT64, float(share)))


def empty() -> bytes:
    """A message that says all by coming (std_msgs/Empty)."""
    return encode(EMPTY, message(EMPTY))


def state_command(word: str, stamp_ns: int) -> bytes:
    """`enable`, `disable`, `pause`, `resume` or `home` (crtk_msgs/StringStamped)."""
    return encode(STRING_STAMPED, message(STRING_STAMPED, _header(stamp_ns), word))


def joints(data: bytes) -> Joints:
    """Joints as measured.

    Raises:
        RosMessageError: where the bytes are no such message. Positions and efforts may be none, or not finite.
    """
    found = decode(JOINT_STATE, data)
    return Joints(_stamp_ns(found), np.array(found.position, np.float64), np.array(found.effort, np.float64))


def pose(data: bytes) -> Pose:
    """A pose as measured.

    Raises:
        RosMessageError: where the bytes are no such message, or its numbers no pose.
    """
    found = decode(POSE_STAMPED, data)
    at, turned = found.pose.position, found.pose.orientation
    p = np.array((at.x, at.y, at.z))
    q = np.array((turned.w, turned.x, turned.y, turned.z))
    # numbers as large as there are overflow in numpy, which tells people so
    norm = math.hypot(*q)
    if not np.isfinite(p).all() or not abs(norm - 1) < _UNIT_TOLERANCE:
        raise RosMessageError("a pose has a place that is not finite, or a quaternion that is not of length 1")
    return Pose(_stamp_ns(found), str(found.header.frame_id), transform(rotation_from_quaternion(q / norm), p))


def operating_state(data: bytes) -> OperatingState:
    """Whether the arm takes commands.

    Raises:
        RosMessageError: where the bytes are no such message.
    """
    found = decode(OPERATING_STATE, data)
    return OperatingState(str(found.state), bool(found.is_homed), bool(found.is_busy))


def flag(data: bytes) -> bool:
    """Whether something is so (std_msgs/Bool).

    Raises:
        RosMessageError: where the bytes are no such message.
    """
    return bool(decode(BOOL, data).data)


def button(data: bytes) -> bool:
    """Whether a button is pressed (sensor_msgs/Joy, of which the first button is 1).

    Raises:
        RosMessageError: where the bytes are no such message, or it has no button.
    """
    buttons = decode(JOY, data).buttons
    if not len(buttons):
        raise RosMessageError("a sensor_msgs/Joy has no button")
    return int(buttons[0]) == 1


def text(data: bytes) -> str:
    """What a std_msgs/String says.

    Raises:
        RosMessageError: where the bytes are no such message.
    """
    return str(decode(STRING, data).data)


def _header(stamp_ns: int) -> Any:
    seconds, rest_ns = divmod(stamp_ns, SECOND_NS)
    stamp = message("builtin_interfaces/msg/Time", seconds % (1 << 31), rest_ns)
    return message("std_msgs/msg/Header", stamp, "")


def _stamp_ns(found: Any) -> int:
    stamp = found.header.stamp
    if not math.isfinite(stamp.sec) or not 0 <= stamp.nanosec < SECOND_NS:
        raise RosMessageError("a stamp has more nanoseconds than a second")
    return int(stamp.sec) * SECOND_NS + int(stamp.nanosec)
