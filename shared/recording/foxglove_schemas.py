"""The few of Foxglove's public message schemas that make a recording open in other programs, by their numbers.

Source: the protobuf schemas that Foxglove publishes (foxglove.RawImage and so on). They live in a descriptor pool of
their own, so that a program that has loaded Foxglove's package may load this module too.
"""

from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    EnumValueDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP_FILE

_F = FieldDescriptorProto
TIME, VECTOR, ROTATION = "google.protobuf.Timestamp", "foxglove.Vector3", "foxglove.Quaternion"
NUMBER = "foxglove.PackedElementField.NumericType"
NUMBERS = "UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"
SCALARS = {"double": _F.TYPE_DOUBLE, "string": _F.TYPE_STRING, "bytes": _F.TYPE_BYTES, "fixed32": _F.TYPE_FIXED32}
FIELDS: dict[str, dict[str, tuple[int, str]]] = {
    "Vector3": {"x": (1, "double"), "y": (2, "double"), "z": (3, "double")},
    "Quaternion": {"x": (1, "double"), "y": (2, "double"), "z": (3, "double"), "w": (4, "double")},
    "FrameTransform": {
        "timestamp": (1, TIME),
        "parent_frame_id": (2, "string"),
        "child_frame_id": (3, "string"),
        "translation": (4, VECTOR),
        "rotation": (5, ROTATION),
    },
    "CompressedImage": {
        "timestamp": (1, TIME),
        "data": (2, "bytes"),
        "format": (3, "string"),
        "frame_id": (4, "string"),
    },
    "RawImage": {
        "timestamp": (1, TIME),
        "width": (2, "fixed32"),
        "height": (3, "fixed32"),
        "encoding": (4, "string"),
        "step": (5, "fixed32"),
        "data": (6, "bytes"),
        "frame_id": (7, "string"),
    },
    "CameraCalibration": {
        "timestamp": (1, TIME),
        "width": (2, "fixed32"),
        "height": (3, "fixed32"),
        "distortion_model": (4, "string"),
        "D": (5, "repeated double"),
        "K": (6, "repeated double"),
        "R": (7, "repeated double"),
        "P": (8, "repeated double"),
        "frame_id": (9, "string"),
    },
    "Pose": {"position": (1, VECTOR), "orientation": (2, ROTATION)},
    "PackedElementField": {"name": (1, "string"), "offset": (2, "fixed32"), "type": (3, NUMBER)},
    "PointCloud": {
        "timestamp": (1, TIME),
        "frame_id": (2, "string"),
        "pose": (3, "foxglove.Pose"),
        "point_stride": (4, "fixed32"),
        "fields": (5, "repeated foxglove.PackedElementField"),
        "data": (6, "bytes"),
    },
}
"""By message and field: the number, and the type."""


def _file() -> FileDescriptorProto:
    file = FileDescriptorProto(
        name="foxglove.proto", package="foxglove", syntax="proto3", dependency=[TIMESTAMP_FILE.name]
    )
    for message, fields in FIELDS.items():
        file.message_type.append(
            DescriptorProto(name=message, field=[_field(name, *numbered) for name, numbered in fields.items()])
        )
    holder = next(message for message in file.message_type if NUMBER.split(".")[1] == message.name)
    values = [EnumValueDescriptorProto(name=name, number=number) for number, name in enumerate(NUMBERS)]
    holder.enum_type.append(EnumDescriptorProto(name=NUMBER.split(".")[2], value=values))
    return file


def _field(name: str, number: int, kind: str) -> FieldDescriptorProto:
    label = _F.LABEL_REPEATED if kind.startswith("repeated ") else _F.LABEL_OPTIONAL
    kind = kind.removeprefix("repeated ")
    if kind in SCALARS:
        return _F(name=name, number=number, label=label, type=SCALARS[kind])
    held = _F.TYPE_ENUM if kind == NUMBER else _F.TYPE_MESSAGE
    return _F(name=name, number=number, label=label, type=held, type_name=f".{kind}")


_TIMESTAMP = FileDescriptorProto()
TIMESTAMP_FILE.CopyToProto(_TIMESTAMP)
DESCRIPTORS = FileDescriptorSet(file=[_TIMESTAMP, _file()]).SerializeToString()
"""The schemas with all that they need, as a recording holds them."""
_POOL = DescriptorPool()
for _one in (_TIMESTAMP, _file()):
    _POOL.Add(_one)
CompressedImage, RawImage, CameraCalibration, FrameTransform, PointCloud = (
    GetMessageClass(_POOL.FindMessageTypeByName(f"foxglove.{name}"))
    for name in ("CompressedImage", "RawImage", "CameraCalibration", "FrameTransform", "PointCloud")
)
