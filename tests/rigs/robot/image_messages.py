"""ROS 2 messages of a camera, as pycdr2 writes them; what a camera's driver would say."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

from pycdr2 import IdlStruct

from agents.dvrk_emulator.messages import Header

if TYPE_CHECKING:
    # what pycdr2 writes as such is these to Python
    uint8: TypeAlias = int
    uint32: TypeAlias = int
    octets: TypeAlias = bytes | list[int]
    numbers: TypeAlias = list[float]
    nine: TypeAlias = list[float]
    twelve: TypeAlias = list[float]
else:
    from pycdr2.types import array, float64, sequence, uint8, uint32

    octets, numbers, nine, twelve = sequence[uint8], sequence[float64], array[float64, 9], array[float64, 12]


@dataclass
class Image(IdlStruct, typename="sensor_msgs/msg/Image"):
    """Pixels."""

    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: octets


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs/msg/CompressedImage"):
    """An image file."""

    header: Header
    format: str
    data: octets


@dataclass
class Roi(IdlStruct, typename="sensor_msgs/msg/RegionOfInterest"):
    """A part of an image."""

    x_offset: uint32 = 0
    y_offset: uint32 = 0
    height: uint32 = 0
    width: uint32 = 0
    do_rectify: bool = False


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs/msg/CameraInfo"):
    """A camera's calibration."""

    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: numbers
    k: nine
    r: nine
    p: twelve
    binning_x: uint32 = 0
    binning_y: uint32 = 0
    roi: Roi = field(default_factory=Roi)
