import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.checks import MessageError
from schemas.codec import LARGE_BYTES, decode, decode_cutting, encode, encode_joining
from schemas.framing import varint
from schemas.messages import (
    CommandRecord,
    FrameStamp,
    Image,
    ImageEncoding,
    StereoFrame,
    TissueSurface,
    ToolCorrection,
)
from schemas.wire import wire_type_named
from tests.schemas.drawn_messages import MESSAGES
from tests.schemas.test_codec import same

NEVER = 1 << 40


@pytest.mark.slow
@pytest.mark.parametrize("message_type", MESSAGES)
@settings(max_examples=4)
@given(data=st.data(), large_bytes=st.integers(1, 48))
def test_large_fields_are_written_and_read_as_protobufs_library_does(message_type, data, large_bytes):
    message = data.draw(MESSAGES[message_type])
    whole = encode(message)
    assert encode_joining(message, large_bytes) == encode_joining(message, NEVER) == whole
    assert encode(decode_cutting(message_type, whole, large_bytes)) == whole


def outcome(message_type, data, large_bytes):
    """The bytes of what is decoded, or why it is refused."""
    try:
        return encode(decode_cutting(message_type, data, large_bytes))
    except MessageError as error:
        return str(error)


@pytest.mark.slow
@pytest.mark.parametrize("message_type", [StereoFrame, TissueSurface, ToolCorrection, CommandRecord])
@settings(max_examples=20)
@given(data=st.data(), large_bytes=st.integers(1, 48))
def test_damage_is_found_whether_or_not_fields_are_cut_out(message_type, data, large_bytes):
    damaged = bytearray(encode(data.draw(MESSAGES[message_type])))
    for place in data.draw(st.lists(st.integers(0, max(0, len(damaged) - 1)), max_size=3)):
        damaged[place : place + 1] = data.draw(st.binary(max_size=3))
    damaged += data.draw(st.sampled_from((b"", bytes(damaged), bytes(damaged[: len(damaged) // 2]))))
    assert outcome(message_type, bytes(damaged), large_bytes) == outcome(message_type, bytes(damaged), NEVER)


def picture(seed, width, height):
    pixels = np.random.default_rng(seed).integers(0, 256, width * height * 3, np.uint8)
    return Image(ImageEncoding.RAW, width, height, 3, pixels.tobytes())


def frame(width, height):
    return StereoFrame(FrameStamp(7, 8, 9, "c"), picture(1, width, height), picture(2, width, height))


def test_a_large_frame_arrives_whole_or_is_refused_when_sent():
    message = frame(320, 240)
    assert len(message.left.data) > LARGE_BYTES
    assert encode(message) == encode_joining(message, NEVER)
    received = decode(StereoFrame, encode(message))
    assert received == message
    assert encode(received) == encode(message)
    assert not np.frombuffer(received.left.data, np.uint8).flags.writeable
    bad = dataclasses.replace(message, stamp=FrameStamp(1, 2**63, 0, "c"))
    with pytest.raises(MessageError, match=r"StereoFrame\.stamp\.capture_left_ns cannot be sent"):
        encode(bad)


@settings(max_examples=8)
@given(data=st.data(), order=st.sampled_from("<>"), step=st.sampled_from([-1, 2]))
def test_strided_and_byte_swapped_arrays_are_joined_as_their_values(data, order, step):
    surface = data.draw(MESSAGES[TissueSurface])
    strided = np.repeat(surface.depth, 2, axis=1)[:, ::2].astype(f"{order}f8")[::step]
    message = dataclasses.replace(
        surface, depth=strided, valid=surface.valid[::step], deviation=None, v_px=surface.v_px[: len(strided)]
    )
    joined = encode_joining(message, 1)
    assert joined == encode_joining(message, NEVER)
    assert same(decode(TissueSurface, joined).depth, strided.astype("<f8"))


@given(st.integers(1, 2**64 - 1))
def test_a_number_is_written_as_protobuf_writes_it(value):
    head = varint(wire_type_named("FrameStamp").SEQUENCE_FIELD_NUMBER << 3)
    assert head + varint(value) == wire_type_named("FrameStamp")(sequence=value).SerializeToString()
