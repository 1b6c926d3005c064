import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.checks import MessageError, fields_of
from schemas.codec import decode, decode_cutting, decode_stamp, encode, encode_joining
from schemas.messages import FrameStamp, TissueSurface
from tests.schemas.drawn_messages import MESSAGES
from tests.schemas.test_codec import same

NEVER = 1 << 40


@pytest.mark.slow
@pytest.mark.parametrize("message_type", MESSAGES)
@settings(max_examples=6)
@given(data=st.data(), large_bytes=st.integers(1, 48))
def test_a_message_survives_the_wire_whether_or_not_large_fields_are_joined(message_type, data, large_bytes):
    message = data.draw(MESSAGES[message_type])
    wire = encode_joining(message, NEVER)
    assert encode(message) == encode_joining(message, large_bytes) == wire
    assert encode(decode_cutting(message_type, wire, large_bytes)) == wire
    found = decode(message_type, wire)
    assert same(found, message)
    assert not any(value.flags.writeable for value in vars(found).values() if isinstance(value, np.ndarray))
    of_a_frame = next(iter(fields_of(message_type).items())) == ("stamp", FrameStamp)
    assert decode_stamp(message_type, wire) == (vars(message)["stamp"] if of_a_frame else None)
    assert decode_stamp(message_type, b"") is None


def outcome(message_type, data, large_bytes):
    """The bytes of what is decoded, or why it is refused, in one sentence; nothing else may be raised."""
    try:
        return encode(decode_cutting(message_type, data, large_bytes))
    except MessageError as error:
        assert str(error).strip()
        assert "\n" not in str(error)
        return str(error)


@pytest.mark.slow
@settings(max_examples=120)
@given(message=st.one_of(*MESSAGES.values()), data=st.data(), large_bytes=st.integers(1, 48))
def test_damage_is_found_whether_or_not_fields_are_cut_out(message, data, large_bytes):
    damaged = bytearray(encode(message))
    for place in data.draw(st.lists(st.integers(0, max(0, len(damaged) - 1)), max_size=3)):
        damaged[place : place + 1] = data.draw(st.binary(max_size=3))
    damaged += data.draw(st.sampled_from((b"", bytes(damaged), bytes(damaged[: len(damaged) // 2]))))
    read_as = data.draw(st.just(type(message)) | st.sampled_from(list(MESSAGES)))
    assert outcome(read_as, bytes(damaged), large_bytes) == outcome(read_as, bytes(damaged), NEVER)


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
