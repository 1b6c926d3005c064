"""The protobuf twins of messages: descriptors and classes, made of their dataclasses when they are first asked for.

A field is numbered by its place among the fields, unless its annotation gives it a `Number`. What it holds follows from
its annotation too: an array is an `Array`, a tuple is repeated, `X | None` is optional, and an enum begins with a value
for what is not said.
"""

import dataclasses
import enum
import functools
import hashlib
import inspect
import re
import textwrap
import typing
from pathlib import Path
from typing import Any

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from schemas.checks import Number, fields_of, is_array, without_none

PACKAGE = "suturegrasp.v1"
PROTO, DESCRIPTORS = (Path(__file__).with_name(f"suturegrasp.{ending}") for ending in ("proto", "desc"))
"""For programs without this package: what protoc takes, and a FileDescriptorProto, which needs no protoc."""
ARRAY = "Array"
ARRAY_FIELDS = (("dtype", "string", False), ("shape", "uint32", True), ("data", "bytes", False))
SCALARS = {bool: "bool", int: "int64", float: "double", str: "string", bytes: "bytes"}
HEAD = """\
syntax = "proto3";

// Every message on the wire, written by `make protos` from the dataclasses in schemas/messages.
// SI units where a name is silent.
package suturegrasp.v1;

// An array of numbers, little endian, in C order; dtype is NumPy's: "<f8", "<i4", "|u1", "|b1".
"""


def wire_type(message_type: Any) -> Any:
    """The class of protobuf's library that a message, or an array, travels as."""
    return wire_type_named(ARRAY if is_array(message_type) else message_type.__name__)


@functools.cache
def wire_type_named(name: str) -> Any:
    """The same by the name of the message.

    Raises:
        KeyError: where there is none.
    """
    return GetMessageClass(_pool().FindMessageTypeByName(f"{PACKAGE}.{name}"))


@functools.cache
def file_descriptor() -> FileDescriptorProto:
    """All messages and enums, in the order in which `schemas/messages` names them."""
    import schemas.messages

    file = FileDescriptorProto(name=PROTO.name, package=PACKAGE, syntax="proto3")
    array = file.message_type.add(name=ARRAY)
    for number, (name, kind, repeated) in enumerate(ARRAY_FIELDS, 1):
        _add_field(array, name, number, kind, repeated)
    for declared in (getattr(schemas.messages, name) for name in schemas.messages.__all__):
        if dataclasses.is_dataclass(declared):
            file.message_type.append(_message(typing.cast(type, declared)))
        elif isinstance(declared, type) and issubclass(declared, enum.Enum):
            file.enum_type.append(_enum(declared))
    return file


def descriptors_of(message: str) -> FileDescriptorProto:
    """A message with all that it holds: the whole file, for each type again, was a third of short recordings."""
    whole = file_descriptor()
    messages = {one.name: one for one in whole.message_type}
    needed, waiting = set[str](), [message]
    while waiting:
        name = waiting.pop()
        if name not in needed:
            needed.add(name)
            fields = messages[name].field if name in messages else ()
            waiting += [field.type_name.split(".")[-1] for field in fields if field.type_name]
    part = FileDescriptorProto(name=whole.name, package=whole.package, syntax=whole.syntax)
    part.message_type.extend(one for one in whole.message_type if one.name in needed)
    part.enum_type.extend(one for one in whole.enum_type if one.name in needed)
    return part


@functools.cache
def descriptor() -> FileDescriptor:
    """The same for protobuf's library."""
    return _pool().FindFileByName(PROTO.name)


@functools.cache
def schemas_hash() -> str:
    """A short name of all messages that this version knows, which changes with any field of them."""
    return hashlib.sha256(file_descriptor().SerializeToString(deterministic=True)).hexdigest()[:12]


def proto_text() -> str:
    """The messages as protoc takes them, each with what its dataclass says of it."""
    import schemas.messages

    file = file_descriptor()
    parts = [HEAD + _message_text(file.message_type[0], {})]
    for one in (*file.enum_type, *file.message_type[1:]):
        declared = getattr(schemas.messages, one.name)
        said = _enum_text(one) if isinstance(one, EnumDescriptorProto) else _message_text(one, fields_of(declared))
        parts.append(_said_of(declared) + said)
    return "\n".join(parts)


@functools.cache
def _pool() -> DescriptorPool:
    # one of its own: the same messages may be loaded from the exported files in this process too
    pool = DescriptorPool()
    pool.Add(file_descriptor())
    return pool


def _message(message_type: type) -> DescriptorProto:
    message = DescriptorProto(name=message_type.__name__)
    hints = _hints(message_type)
    given = {name: number for name, hint in hints.items() if (number := _number(hint)) is not None}
    free = (number for number in range(1, len(hints) + 1) if number not in given.values())
    for name, hint in hints.items():
        declared = without_none(hint)
        inner = typing.get_args(declared)[0] if name in given else declared
        repeated = typing.get_origin(inner) is tuple
        kind = _kind(typing.get_args(inner)[0] if repeated else inner)
        _add_field(message, name, given.get(name) or next(free), kind, repeated, optional=declared is not hint)
    return message


def _hints(message_type: type) -> dict[str, Any]:
    """The fields in order of declaration, with whatever their annotations say beside the type."""
    hints = typing.get_type_hints(message_type, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(message_type)}


def _number(hint: Any) -> int | None:
    return next((extra.number for extra in getattr(hint, "__metadata__", ()) if isinstance(extra, Number)), None)


def _kind(declared: Any) -> str:
    """A scalar by its name in proto files, an enum with a dot before its own, a message by its own."""
    if is_array(declared):
        return ARRAY
    if extras := getattr(declared, "__metadata__", ()):
        return extras[0]
    if declared in SCALARS:
        return SCALARS[declared]
    return f".{declared.__name__}" if issubclass(declared, enum.Enum) else declared.__name__


def _add_field(to: DescriptorProto, name: str, number: int, kind: str, repeated: bool, optional: bool = False) -> None:
    label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
    field = to.field.add(name=name, number=number, label=label)
    if kind.islower():
        field.type = getattr(FieldDescriptorProto, f"TYPE_{kind.upper()}")
    else:
        field.type = FieldDescriptorProto.TYPE_ENUM if kind.startswith(".") else FieldDescriptorProto.TYPE_MESSAGE
        field.type_name = f".{PACKAGE}.{kind.removeprefix('.')}"
    # protobuf knows of every message whether it is there
    if optional and field.type != FieldDescriptorProto.TYPE_MESSAGE:
        field.proto3_optional, field.oneof_index = True, len(to.oneof_decl)
        to.oneof_decl.add(name=f"_{name}")


def _enum(declared: type[enum.Enum]) -> EnumDescriptorProto:
    prefix = re.sub(r"(?<!^)([A-Z])", r"_\1", declared.__name__).upper()
    made = EnumDescriptorProto(name=declared.__name__)
    made.value.add(name=f"{prefix}_UNSPECIFIED", number=0)
    for member in declared:
        made.value.add(name=f"{prefix}_{member.name}", number=member.value)
    return made


def _said_of(declared: type) -> str:
    return textwrap.indent(inspect.getdoc(declared) or "", "// ", lambda _: True).replace("// \n", "//\n") + "\n"


def _message_text(message: DescriptorProto, declared: dict[str, Any]) -> str:
    lines = (
        f"  {_label(field)}{_type_text(field)} {field.name} = {field.number};{_layout(declared.get(field.name))}\n"
        for field in message.field
    )
    return f"message {message.name} {{\n{''.join(lines)}}}\n"


def _layout(declared: Any) -> str:
    """Elements and axes of an array, as a comment."""
    array = without_none(declared)
    return f"  // {array.dtypes[0]} ({', '.join(array.dim_str.split())})" if is_array(array) else ""


def _label(field: FieldDescriptorProto) -> str:
    if field.label == FieldDescriptorProto.LABEL_REPEATED:
        return "repeated "
    return "optional " if field.proto3_optional else ""


def _type_text(field: FieldDescriptorProto) -> str:
    return field.type_name.rpartition(".")[2] or FieldDescriptorProto.Type.Name(field.type)[5:].lower()


def _enum_text(declared: EnumDescriptorProto) -> str:
    values = "".join(f"  {value.name} = {value.number};\n" for value in declared.value)
    return f"enum {declared.name} {{\n{values}}}\n"


def export() -> None:
    """Write both files."""
    PROTO.write_text(proto_text())
    DESCRIPTORS.write_bytes(file_descriptor().SerializeToString(deterministic=True))


if __name__ == "__main__":
    export()
