"""The dataclasses, the proto file and the committed generated code say the same thing."""

import dataclasses
import enum
import pathlib
import typing

import pytest
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from grpc_tools import protoc

import schemas.messages
from schemas.checks import fields_of, is_array, without_none
from schemas.generated import suturegrasp_pb2

SCHEMAS = pathlib.Path(schemas.messages.__file__).parents[1]
WIRE = suturegrasp_pb2.DESCRIPTOR
DECLARED = {
    name: value
    for name, value in vars(schemas.messages).items()
    if isinstance(value, type) and value.__module__.startswith(schemas.messages.__name__)
}
MESSAGES = {name: value for name, value in DECLARED.items() if dataclasses.is_dataclass(value)}
ENUMS = {name: value for name, value in DECLARED.items() if issubclass(value, enum.Enum)}
SCALARS = {
    bool: {FieldDescriptor.CPPTYPE_BOOL},
    int: {FieldDescriptor.CPPTYPE_INT64, FieldDescriptor.CPPTYPE_UINT64, FieldDescriptor.CPPTYPE_UINT32},
    float: {FieldDescriptor.CPPTYPE_DOUBLE},
    str: {FieldDescriptor.CPPTYPE_STRING},
    bytes: {FieldDescriptor.CPPTYPE_STRING},
}


def wire_kind(field):
    """What a field of the proto file holds, in the words of `declared_kind`."""
    if field.message_type:
        kind = field.message_type.name
    elif field.enum_type:
        kind = field.enum_type.name
    elif field.type == FieldDescriptor.TYPE_BYTES:
        kind = "bytes"
    else:
        kind = next(python.__name__ for python, kinds in SCALARS.items() if field.cpp_type in kinds)
    if field.is_repeated:
        return f"many {kind}"
    return f"optional {kind}" if field.has_presence and not field.message_type else kind


def declared_kind(annotation):
    inner = without_none(annotation)
    if is_array(inner):
        kind = "Array"
    elif typing.get_origin(inner) is tuple:
        kind = f"many {typing.get_args(inner)[0].__name__}"
    else:
        kind = inner.__name__
    # protobuf knows of every sub-message whether it is there, so that is not said again
    unsaid = kind == "Array" or dataclasses.is_dataclass(inner)
    return kind if inner is annotation or unsaid else f"optional {kind}"


def generated_now(folder):
    """Run protoc on the committed proto files as `make protos` does."""
    proto = SCHEMAS / "proto"
    files = [str(path) for path in sorted(proto.glob("*.proto"))]
    outputs = [f"--python_out={folder}", f"--pyi_out={folder}", f"--descriptor_set_out={folder / 'set'}"]
    assert protoc.main(["protoc", f"--proto_path={proto}", *outputs, *files]) == 0
    return FileDescriptorSet.FromString((folder / "set").read_bytes())


def test_every_dataclass_has_a_proto_message_and_the_other_way_round():
    assert set(MESSAGES) == set(WIRE.message_types_by_name) - {"Array"}


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_has_the_same_fields_of_the_same_kinds_in_the_same_order(name):
    declared = [(field, declared_kind(annotation)) for field, annotation in fields_of(MESSAGES[name]).items()]
    assert declared == [(field.name, wire_kind(field)) for field in WIRE.message_types_by_name[name].fields]


def test_every_enum_has_the_same_names_and_numbers():
    assert set(ENUMS) == set(WIRE.enum_types_by_name)
    for name, members in ENUMS.items():
        on_the_wire = {value.name: value.number for value in WIRE.enum_types_by_name[name].values}
        prefix = "".join(f"_{letter}" if letter.isupper() else letter for letter in name).strip("_").upper()
        expected = {f"{prefix}_UNSPECIFIED": 0} | {f"{prefix}_{member.name}": member.value for member in members}
        assert on_the_wire == expected


def test_the_committed_code_is_what_protoc_generates(tmp_path):
    (file,) = generated_now(tmp_path).file
    for message in file.message_type:
        for field in message.field:
            field.ClearField("json_name")  # protoc fills it in for a descriptor set, and not for generated code
    committed = FileDescriptorProto()
    WIRE.CopyToProto(committed)
    for message in committed.message_type:
        for field in message.field:
            field.ClearField("json_name")
    assert committed == file, "run `make protos`"
    stubs = "suturegrasp_pb2.pyi"
    assert (tmp_path / stubs).read_text() == (SCHEMAS / "generated" / stubs).read_text(), "run `make protos`"
