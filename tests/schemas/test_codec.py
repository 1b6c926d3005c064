import contextlib
import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas import messages
from schemas.checks import MessageError
from schemas.codec import LEADING_TO_MOTION, MAX_MESSAGE_BYTES, decode, decode_stamp, encode, encoding_name
from schemas.framing import varint
from schemas.wire import wire_type, wire_type_named
from tests.schemas.drawn_messages import MESSAGES, RECORDED


def same(a, b):
    """Equality of two values, field by field and bit by bit."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


@settings(max_examples=40)
@given(message=st.one_of(*MESSAGES.values()), garbage=st.binary(min_size=1, max_size=30))
def test_trailing_garbage_never_passes_unnoticed(message, garbage):
    # garbage may happen to be well-formed known fields, which then are part of the message by protobuf's rules
    with contextlib.suppress(MessageError):
        found = decode(type(message), encode(message) + garbage)
        reparsed = wire_type(type(message)).FromString(encode(message) + garbage)
        if type(message) not in LEADING_TO_MOTION:
            reparsed.DiscardUnknownFields()
        assert encode(found) == reparsed.SerializeToString(deterministic=True)


def test_a_damaged_stamp_is_refused_and_damage_behind_it_not_noticed():
    raw = messages.Image(messages.ImageEncoding.RAW, 1, 1, 1, b"\0")
    frame = messages.StereoFrame(messages.FrameStamp(0, 0, 0, ""), raw, raw)
    assert decode_stamp(messages.StereoFrame, encode(frame) + b"\xff") == frame.stamp
    with pytest.raises(MessageError, match="FrameStamp"):
        decode_stamp(messages.StereoFrame, b"\x0a\x02\xff\xff")


def observed():
    """A small set of observations as its protobuf twin, ready to be spoilt."""
    seen = {"points_camera": np.array([[0.0, 0, 10], [1, 0, 11]]), "half_size_px": np.ones((2, 2))}
    pairs = {"matched_px": np.ones((3, 3)), "match_cost": np.ones((3, 2)), "inlier": np.array([True, False, True])}
    judgements = (messages.Judgement("ROWS", messages.Severity.NOTE, "f", "r"),)
    message = RECORDED[messages.ThreadObservations][0]
    message = dataclasses.replace(message, **seen, **pairs, gaps=np.zeros(0, np.int64), judgements=judgements)
    return wire_type_named("ThreadObservations").FromString(encode(message))


SPOILT = [
    (lambda m: m.ClearField("stamp"), r"ThreadObservations\.stamp is missing"),
    (lambda m: m.ClearField("inlier"), "inlier is missing"),
    (lambda m: m.ClearField("status"), r"status is unspecified; .* 1 \(OK\), 2"),
    (lambda m: setattr(m.judgements[0], "severity", 77), r"judgements\[0\]\.severity has the unknown value 77"),
    (lambda m: setattr(m.points_camera, "dtype", ">f8"), "points_camera must hold <f8, not '>f8'"),
    (lambda m: setattr(m.half_size_px, "data", b"\0" * 31), r"31 bytes where its shape \(2, 2\) needs 32"),
    (lambda m: m.inlier.shape.__setitem__(0, 2**32 - 1), "inlier holds 3 bytes where its shape .* needs 4294967295"),
    (lambda m: m.inlier.shape.extend([2**32 - 1] * 1000), r"inlier must have shape \(p\)"),
    (lambda m: m.points_camera.shape.__setitem__(slice(None), [3, 2]), r"must have shape \(n, 3\), not \(3, 2\)"),
    (lambda m: setattr(m.inlier, "data", b"\0\1\2"), "inlier holds bytes that are neither true"),
    (lambda m: setattr(m.mask_left, "data", b""), r"mask_left: Image\.data holds 0 bytes"),
    (lambda m: m.inlier.MergeFromString(b"\xf8\x3f\x01"), "inlier has fields that this version does not know"),
]


@pytest.mark.parametrize(("spoil", "text"), SPOILT)
def test_the_error_names_the_field_and_the_fault(spoil, text):
    wire = observed()
    decode(messages.ThreadObservations, wire.SerializeToString())
    spoil(wire)
    with pytest.raises(MessageError, match=text):
        decode(messages.ThreadObservations, wire.SerializeToString())


@pytest.mark.parametrize(
    ("message_type", "data", "said"),
    [
        (messages.StereoFrame, b"", r"StereoFrame\.stamp is missing"),
        (messages.StereoFrame, b"\x0a\x7f", "StereoFrame cannot be read: its 2 bytes are damaged or of another type"),
        (messages.Judgement, b"\x0a\x02\xff\xfe", "Judgement cannot be read"),
        (messages.Image, bytes(MAX_MESSAGE_BYTES + 1), "Image is too large"),
        # a text in the place of a number
        (messages.Consumed, encode(messages.Consumed("k", 1, 2)) + b"\x12\x01x", r"does not know \(numbers 2\)"),
    ],
    ids=lambda value: value[:20] if isinstance(value, bytes) else None,
)
def test_bytes_that_are_no_message_are_refused(message_type, data, said):
    with pytest.raises(MessageError, match=said):
        decode(message_type, data)


def test_whatever_could_move_a_robot_or_says_where_it_goes_is_understood_in_full():
    assert {message_type.__name__ for message_type in LEADING_TO_MOTION} == {
        *("GraspGoal", "GraspPlan", "Arm", "ChangeState", "Heartbeat"),
        *("ReplayClock", "SetParameter", "ToolCorrection", "FrameNotice"),
    }


def added(number):
    """A field of that number, which holds 1."""
    return varint(number << 3) + b"\1"


@pytest.mark.parametrize("message_type", MESSAGES)
@settings(max_examples=1)
@given(data=st.data())
def test_what_a_newer_version_added_is_left_out_except_where_it_could_move_a_robot(message_type, data):
    message = data.draw(MESSAGES[message_type])
    wire = encode(message) + added(len(wire_type(message_type).DESCRIPTOR.fields) + 1)
    if message_type in LEADING_TO_MOTION:
        with pytest.raises(MessageError, match="has fields that this version does not know"):
            decode(message_type, wire)
    else:
        assert same(decode(message_type, wire), message)


def test_what_a_newer_version_added_within_a_goal_is_refused_and_within_observations_left_out():
    wire = observed()
    wire.camera.MergeFromString(added(900))
    assert decode(messages.ThreadObservations, wire.SerializeToString()).camera.fx_px == wire.camera.fx_px
    goal = wire_type_named("GraspGoal")()
    goal.header.MergeFromString(added(900))
    with pytest.raises(MessageError, match=r"GraspGoal.header has fields that this version does not know"):
        decode(messages.GraspGoal, goal.SerializeToString())


def test_a_value_that_does_not_fit_its_field_cannot_be_sent_and_the_type_is_told_beside_the_bytes():
    message = decode(messages.ThreadObservations, observed().SerializeToString())
    half_a_surrogate_pair = messages.Judgement("\ud800", messages.Severity.NOTE, "f", "r")
    with pytest.raises(MessageError, match=r"ThreadObservations\.judgements\[0\]\.code cannot be sent"):
        encode(dataclasses.replace(message, judgements=(half_a_surrogate_pair,)))
    assert encoding_name(messages.StereoFrame) == "application/protobuf;suturegrasp.v1.StereoFrame"
