"""ROS 2 messages of the emulated console, as pycdr2 writes and reads them."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

from pycdr2 import IdlStruct

if TYPE_CHECKING:
    # what pycdr2 writes as such is these to Python
    int32: TypeAlias = int
    uint32: TypeAlias = int
    uint8: TypeAlias = int
    float64: TypeAlias = float
    words: TypeAlias = list[str]
    numbers: TypeAlias = list[float]
    floats: TypeAlias = list[float]
    counts: TypeAlias = list[int]
else:
    from pycdr2.types import float32, float64, int32, sequence, uint8, uint32

    words, numbers, floats, counts = sequence[str], sequence[float64], sequence[float32], sequence[int32]

SECOND_NS = 1_000_000_000


@dataclass
class Time(IdlStruct, typename="builtin_interfaces/msg/Time"):
    """A point in time."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs/msg/Header"):
    """When and in which frame."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class JointState(IdlStruct, typename="sensor_msgs/msg/JointState"):
    """Joints."""

    header: Header = field(default_factory=Header)
    name: words = field(default_factory=list)
    position: numbers = field(default_factory=list)
    velocity: numbers = field(default_factory=list)
    effort: numbers = field(default_factory=list)


@dataclass
class Point(IdlStruct, typename="geometry_msgs/msg/Point"):
    """A place in metres."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs/msg/Quaternion"):
    """A rotation."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs/msg/Pose"):
    """A place and a rotation."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs/msg/PoseStamped"):
    """A pose at a time."""

    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass
class Joy(IdlStruct, typename="sensor_msgs/msg/Joy"):
    """Buttons, of which a console has one in each message."""

    header: Header = field(default_factory=Header)
    axes: floats = field(default_factory=list)
    buttons: counts = field(default_factory=list)


@dataclass
class OperatingState(IdlStruct, typename="crtk_msgs/msg/OperatingState"):
    """Whether the arm takes commands."""

    header: Header = field(default_factory=Header)
    state: str = ""
    is_homed: bool = False
    is_busy: bool = False


@dataclass
class StringStamped(IdlStruct, typename="crtk_msgs/msg/StringStamped"):
    """A word at a time."""

    header: Header = field(default_factory=Header)
    string: str = ""


@dataclass
class String(IdlStruct, typename="std_msgs/msg/String"):
    """A word."""

    data: str = ""


@dataclass
class Bool(IdlStruct, typename="std_msgs/msg/Bool"):
    """Yes or no."""

    data: bool = False


@dataclass
class Float64(IdlStruct, typename="std_msgs/msg/Float64"):
    """A number."""

    data: float64 = 0.0


@dataclass
class Empty(IdlStruct, typename="std_msgs/msg/Empty"):
    """Nothing; IDL knows no structure without a member."""

    structure_needs_at_least_one_member: uint8 = 0


def header(now_ns: int, frame: str = "") -> Header:
    """A header of now."""
    return Header(Time(now_ns // SECOND_NS, now_ns % SECOND_NS), frame)
