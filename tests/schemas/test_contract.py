"""What is exported for programs of others is what the messages are, in a form that protoc takes."""

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from grpc_tools import protoc

from schemas.wire import DESCRIPTORS, PROTO, file_descriptor, proto_text


def test_the_exported_files_are_of_these_messages():
    assert PROTO.read_text() == proto_text(), "run `make protos`"
    assert DESCRIPTORS.read_bytes() == file_descriptor().SerializeToString(deterministic=True), "run `make protos`"


def test_protoc_makes_the_same_messages_of_the_exported_file(tmp_path):
    output = tmp_path / "set"
    asked = ["protoc", f"--proto_path={PROTO.parent}", f"--descriptor_set_out={output}", str(PROTO)]
    assert protoc.main(asked) == 0
    (file,) = FileDescriptorSet.FromString(output.read_bytes()).file
    for message in file.message_type:
        for field in message.field:
            field.ClearField("json_name")
    # an enum stands before the messages in the text
    assert file == file_descriptor()
