"""Messages to bytes and back: one codec for all of them, driven by the annotations of their dataclasses.

A message's protobuf twin has the same name and the same field names. Protobuf accepts nearly anything (no bytes at
all decode to zeros), so decoding trusts nothing: whatever arrives is either a message that passes its own checks,
or a MessageError that says what is wrong with which field. A field that this version does not know is damage, unless
its number is above all that it knows: then a newer version has added it, and it is left out; but never from a message
that leads to motion, since what it means for a robot is unknown (docs/decisions.md, 15).
"""

import dataclasses
import enum
import functools
import math
import typing
from typing import Any, TypeVar

import numpy as np
from google.protobuf.message import DecodeError
from google.protobuf.unknown_fields import UnknownFieldSet

from schemas.checks import MessageError, fields_of, is_array, require, without_none
from schemas.framing import NotCutError, cut, delimited, first_field
from schemas.messages import (
    Arm,
    ChangeState,
    FrameNotice,
    FrameStamp,
    GraspGoal,
    GraspPlan,
    Heartbeat,
    ReplayClock,
    SetParameter,
    ToolCorrection,
)
from schemas.wire import ARRAY, wire_type, wire_type_named

LEADING_TO_MOTION = (
    *(GraspGoal, GraspPlan, Arm, ChangeState, Heartbeat),
    *(ReplayClock, SetParameter, ToolCorrection, FrameNotice),
)
"""Messages that are understood in full or not at all. What stops a robot is not among them: it is always understood."""

MAX_MESSAGE_BYTES = 1 << 28
"""256 MiB: above five times a raw stereo pair at 4K, and far below what would hurt a machine."""

LARGE_BYTES = 1 << 16
"""From here on, joining takes less than protobuf's library does: for an image of 1.5 MB 0.04 instead of 2.9 ms."""

STAMP = "stamp"
"""What messages of a frame call its number and times; the first field of those that come with every frame."""

M = TypeVar("M")


def encoding_name(message_type: type) -> str:
    """The name under which a message type travels, as Zenoh's encoding: `application/protobuf;package.Name`."""
    return f"application/protobuf;{wire_type(message_type).DESCRIPTOR.full_name}"


def encode(message: Any) -> bytes:
    """The bytes of a message; equal messages have equal bytes.

    Raises:
        MessageError: where a value does not fit its field on the wire.
    """
    return encode_joining(message, LARGE_BYTES)


def encode_joining(message: Any, large_bytes: int) -> bytes:
    """As `encode`; bytes and arrays of at least that size are joined to the rest, past protobuf's library."""
    return b"".join(encoded_parts(message, large_bytes))


def encoded_parts(message: Any, large_bytes: int = LARGE_BYTES) -> list[Any]:
    """What `encode` joins: more than one part only where bytes or arrays of at least that size are among them."""
    where = type(message).__name__
    if _holds_large(message, large_bytes):
        return _parts(message, where, large_bytes)
    wire = wire_type(type(message))()
    _write(wire, message, where)
    return [wire.SerializeToString(deterministic=True)]


def decode(message_type: type[M], data: bytes) -> M:
    """The message of that type in these bytes. Its arrays, and bytes from LARGE_BYTES on, are read-only views of them.

    Raises:
        MessageError: where they hold none; the text names the field and what is wrong with it.
    """
    return decode_cutting(message_type, data, LARGE_BYTES)


def decode_stamp(message_type: type, data: bytes) -> FrameStamp | None:
    """The stamp of a message of a frame, without the rest of it: for whoever leaves most frames out.

    None where these bytes do not begin with one, as those that `encode` makes of such a message do.

    Raises:
        MessageError: where they begin with one that is damaged. Damage behind it is not noticed.
    """
    if not data or fields_of(message_type).get(STAMP) is not FrameStamp:
        return None
    try:
        number, inside = first_field(memoryview(data))
    except NotCutError:
        return None
    is_stamp = _fields_by_number(message_type)[0][:2] == (number, STAMP)
    return decode(FrameStamp, bytes(inside)) if is_stamp else None


def decode_cutting(message_type: type[M], data: bytes, large_bytes: int) -> M:
    """As `decode`; bytes and arrays of at least that size are cut out of the rest, past protobuf's library."""
    name = message_type.__name__
    require(len(data) <= MAX_MESSAGE_BYTES, f"{name} is too large: {len(data)} bytes, of {MAX_MESSAGE_BYTES} allowed")
    try:
        found = _parsed(message_type, data, large_bytes)
    except DecodeError as error:
        raise MessageError(f"{name} cannot be read: its {len(data)} bytes are damaged or of another type") from error
    # Finite yet absurd numbers overflow in a message's own checks, which then fail as they should.
    with np.errstate(all="ignore"):
        return _read(found, message_type, name, in_full=message_type in LEADING_TO_MOTION)


@dataclasses.dataclass
class _Found:
    """What has arrived as a message: what protobuf's library has read, and what was cut out before, by name."""

    wire: Any
    large: dict[str, Any]

    def has(self, name: str) -> bool:
        return name in self.large or self.wire.HasField(name)

    def value(self, name: str) -> Any:
        return self.large[name] if name in self.large else getattr(self.wire, name)

    def message(self, name: str) -> "_Found":
        return self.large[name] if name in self.large else _Found(getattr(self.wire, name), {})


def _parsed(message_type: Any, data: bytes, large_bytes: int) -> _Found:
    if len(data) >= large_bytes:
        try:
            return _cut(message_type, memoryview(data), large_bytes)
        except NotCutError:
            pass
    return _Found(wire_type(message_type).FromString(data), {})


def _cut(message_type: Any, data: memoryview, large_bytes: int) -> _Found:
    fields = _single_roomy_fields(message_type)
    rest, large = cut(data, fields, large_bytes)
    named: dict[str, Any] = {}
    for number, inside in large.items():
        name, declared = fields[number]
        holds_more = _is_message(declared) or is_array(declared)
        named[name] = _cut(declared, inside, large_bytes) if holds_more else inside
    return _Found(wire_type(message_type).FromString(rest), named)


def _write(wire: Any, message: Any, where: str) -> None:
    for name, annotation in fields_of(type(message)).items():
        _write_field(wire, name, getattr(message, name), without_none(annotation), f"{where}.{name}")


def _write_field(wire: Any, name: str, value: Any, declared: Any, where: str) -> None:
    if value is None:
        return
    if is_array(declared):
        _write_array(getattr(wire, name), value, declared)
    elif _item_type(declared):
        for index, item in enumerate(value):
            _write(getattr(wire, name).add(), item, f"{where}[{index}]")
    elif _is_message(declared):
        getattr(wire, name).SetInParent()
        _write(getattr(wire, name), value, where)
    else:
        _write_scalar(wire, name, value, where)


def _holds_large(value: Any, large_bytes: int) -> bool:
    """Whether bytes or an array of at least that size lie in a value, itself included."""
    if isinstance(value, bytes | memoryview):
        return len(value) >= large_bytes
    if isinstance(value, np.ndarray):
        return value.nbytes >= large_bytes
    if isinstance(value, tuple):
        return any(_holds_large(item, large_bytes) for item in value)
    # what is none of these is refused where it is written
    return dataclasses.is_dataclass(value) and any(
        _holds_large(getattr(value, name), large_bytes) for name in _roomy_fields(type(value))
    )


def _parts(message: Any, where: str, large_bytes: int) -> list[Any]:
    """A message's bytes in parts; what is small between two large fields is left to protobuf's library."""
    parts: list[Any] = []
    small = wire_type(type(message))()
    for number, name, declared in _fields_by_number(type(message)):
        value, here = getattr(message, name), f"{where}.{name}"
        if not _holds_large(value, large_bytes):
            _write_field(small, name, value, declared, here)
            continue
        item_type = _item_type(declared)
        for item, place in ((v, f"{here}[{i}]") for i, v in enumerate(value)) if item_type else ((value, here),):
            parts.append(small.SerializeToString(deterministic=True))
            small.Clear()
            parts += delimited(number, _inner_parts(item, item_type or declared, place, large_bytes))
    return [*parts, small.SerializeToString(deterministic=True)]


def _inner_parts(value: Any, declared: Any, where: str, large_bytes: int) -> list[Any]:
    if _is_message(declared):
        return _parts(value, where, large_bytes)
    if not is_array(declared):
        return [value]
    wire, dtype = wire_type_named(ARRAY)(), _wire_dtype(declared)
    wire.dtype = dtype.str
    wire.shape.extend(value.shape)
    data = np.ascontiguousarray(value, dtype).reshape(-1).view(np.uint8)
    return [wire.SerializeToString(deterministic=True), *delimited(wire.DATA_FIELD_NUMBER, [data])]


def _write_scalar(wire: Any, name: str, value: Any, where: str) -> None:
    try:
        setattr(wire, name, _on_the_wire(value))
    except (TypeError, ValueError) as error:
        raise MessageError(f"{where} cannot be sent: {error}") from error


def _on_the_wire(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return value.value
    return bytes(value) if isinstance(value, memoryview) else value


def _write_array(wire: Any, array: np.ndarray, declared: Any) -> None:
    dtype = _wire_dtype(declared)
    wire.dtype = dtype.str
    wire.shape.extend(array.shape)
    wire.data = array.astype(dtype, copy=False).tobytes()


def _read(found: _Found, message_type: type[M], where: str, in_full: bool) -> M:
    _refuse_unknown_fields(found.wire, where, in_full)
    values = {field.name: _read_field(found, field, where, in_full) for field in _fields_to_read(message_type)}
    try:
        return message_type(**values)
    except MessageError as error:
        nested = "." in where
        raise MessageError(f"{where}: {error}" if nested else str(error)) from error


class _Field(typing.NamedTuple):
    """A field as it is read: what of its annotation would otherwise be taken apart for each message."""

    name: str
    declared: Any
    item_type: Any
    optional: bool
    is_array: bool
    is_message: bool
    is_enum: bool


@functools.cache
def _fields_to_read(message_type: type) -> tuple[_Field, ...]:
    fields: list[_Field] = []
    for name, annotation in fields_of(message_type).items():
        declared = without_none(annotation)
        item_type, array = _item_type(declared), is_array(declared)
        is_enum = not (item_type or array) and issubclass(declared, enum.Enum)
        optional = declared is not annotation
        fields.append(_Field(name, declared, item_type, optional, array, _is_message(declared), is_enum))
    return tuple(fields)


def _read_field(found: _Found, field: _Field, of: str, in_full: bool) -> Any:
    name, declared, where = field.name, field.declared, f"{of}.{field.name}"
    if field.item_type:
        items = enumerate(getattr(found.wire, name))
        return tuple(_read(_Found(item, {}), field.item_type, f"{where}[{i}]", in_full) for i, item in items)
    if (field.optional or field.is_array or field.is_message) and not found.has(name):
        require(field.optional, f"{where} is missing")
        return None
    if field.is_array:
        return _read_array(found.message(name), declared, where)
    if field.is_message:
        return _read(found.message(name), declared, where, in_full)
    value = found.value(name)
    return _read_enum(value, declared, where) if field.is_enum else value


def _read_enum(number: int, declared: type[enum.Enum], where: str) -> enum.Enum:
    try:
        return declared(number)
    except ValueError as error:
        known = ", ".join(f"{member.value} ({member.name})" for member in declared)
        found = "is unspecified" if number == 0 else f"has the unknown value {number}"
        raise MessageError(f"{where} {found}; it must be one of {known}") from error


def _read_array(found: _Found, declared: Any, where: str) -> np.ndarray:
    _refuse_unknown_fields(found.wire, where, in_full=True)
    wire, data = found.wire, found.value("data")
    dtype, name, axes, fixed = _layout(declared)
    shape = tuple(wire.shape)
    # the texts are made for what is wrong alone, as in schemas/checks.py
    if wire.dtype != name:
        raise MessageError(f"{where} must hold {name}, not {wire.dtype[:20]!r}")
    # Before any reshape: an array without elements may still claim axes too long for NumPy to index.
    if len(shape) != len(axes) or any(shape[axis] != length for axis, length in fixed):
        raise MessageError(f"{where} must have shape ({', '.join(axes)}), not {shape[:8]}")
    expected = math.prod(shape) * dtype.itemsize
    if len(data) != expected:
        raise MessageError(f"{where} holds {len(data)} bytes where its shape {shape} needs {expected}")
    if dtype.kind == "b":
        require(not bytes(data).strip(b"\0\1"), f"{where} holds bytes that are neither true (1) nor false (0)")
    return np.frombuffer(data, dtype).reshape(shape)


@functools.cache
def _layout(declared: Any) -> tuple[np.dtype, str, tuple[str, ...], tuple[tuple[int, int], ...]]:
    """Element type with its name on the wire, axes, and place and length of those whose length is given."""
    dtype, axes = _wire_dtype(declared), tuple(declared.dim_str.split())
    return dtype, dtype.str, axes, tuple((k, int(axis)) for k, axis in enumerate(axes) if axis.isdigit())


def _refuse_unknown_fields(wire: Any, where: str, in_full: bool) -> None:
    left = UnknownFieldSet(wire)
    if len(left) == 0:
        return
    unknown = sorted({field.field_number for field in left})
    if not in_full:
        last = max((field.number for field in wire.DESCRIPTOR.fields), default=0)
        unknown = [number for number in unknown if number <= last]
    require(
        not unknown,
        f"{where} has fields that this version does not know (numbers {', '.join(map(str, unknown[:5]))}): "
        "it is damaged, or its sender is newer",
    )


@functools.cache
def _fields_by_number(message_type: type) -> list[tuple[int, str, Any]]:
    """Number, name and type of each field, as they follow one another on the wire."""
    declared = fields_of(message_type)
    fields = sorted(wire_type(message_type).DESCRIPTOR.fields, key=lambda field: field.number)
    return [(field.number, field.name, without_none(declared[field.name])) for field in fields]


@functools.cache
def _roomy_fields(message_type: type) -> list[str]:
    """The fields under which bytes or arrays may lie."""
    declared = {name: without_none(annotation) for name, annotation in fields_of(message_type).items()}
    return [name for name, type_ in declared.items() if _is_roomy(_item_type(type_) or type_)]


@functools.cache
def _single_roomy_fields(message_type: Any) -> dict[int, tuple[str, Any]]:
    """Name and type by number of the fields that are not repeated under which bytes or arrays may lie."""
    if is_array(message_type):
        return {wire_type_named(ARRAY).DATA_FIELD_NUMBER: ("data", bytes)}
    fields = _fields_by_number(message_type)
    return {number: (name, type_) for number, name, type_ in fields if not _item_type(type_) and _is_roomy(type_)}


def _is_roomy(declared: Any) -> bool:
    return declared is bytes or is_array(declared) or (_is_message(declared) and bool(_roomy_fields(declared)))


@functools.cache
def _wire_dtype(declared: Any) -> np.dtype:
    return np.dtype(declared.dtypes[0]).newbyteorder("<")


@functools.cache
def _is_message(declared: Any) -> bool:
    return dataclasses.is_dataclass(declared)


@functools.cache
def _item_type(declared: Any) -> type | None:
    """The X of `tuple[X, ...]`, and None for any other annotation."""
    return typing.get_args(declared)[0] if typing.get_origin(declared) is tuple else None
