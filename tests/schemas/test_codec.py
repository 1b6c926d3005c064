import dataclasses
import string

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.checks import MessageError, fields_of
from schemas.codec import LEADING_TO_MOTION, MAX_MESSAGE_BYTES, decode, decode_stamp, encode, encoding_name
from schemas.messages import (
    Consumed,
    FrameStamp,
    GraspGoal,
    Image,
    ImageEncoding,
    Judgement,
    RectifiedStereo,
    Severity,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
)
from schemas.wire import wire_type, wire_type_named
from tests.schemas.drawn_messages import MESSAGES

any_message = st.one_of(*MESSAGES.values())
message_types = st.sampled_from(list(MESSAGES))
every_message_type = pytest.mark.parametrize("message_type", MESSAGES)


def same(a, b):
    """Equality of two values, field by field and bit by bit."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


def decoded_or_refused(message_type, data):
    """What came of the bytes; anything but a message or a MessageError escapes and fails the test."""
    try:
        return decode(message_type, data)
    except MessageError as error:
        assert str(error).strip()
        assert "\n" not in str(error)
        return None


@pytest.mark.slow
@every_message_type
@settings(max_examples=6)
@given(data=st.data())
def test_a_message_survives_the_wire(message_type, data):
    message = data.draw(MESSAGES[message_type])
    wire = encode(message)
    found = decode(message_type, wire)
    assert same(found, message)
    assert encode(message) == encode(found) == wire
    assert not any(value.flags.writeable for value in vars(found).values() if isinstance(value, np.ndarray))
    of_a_frame = next(iter(fields_of(message_type).items())) == ("stamp", FrameStamp)
    assert decode_stamp(message_type, wire) == (vars(message)["stamp"] if of_a_frame else None)
    assert decode_stamp(message_type, b"") is None


def test_a_damaged_stamp_is_refused_and_damage_behind_it_not_noticed():
    raw = Image(ImageEncoding.RAW, 1, 1, 1, b"\0")
    frame = StereoFrame(FrameStamp(0, 0, 0, ""), raw, raw)
    assert decode(StereoFrame, encode(frame)) == frame
    assert decode_stamp(StereoFrame, encode(frame) + b"\xff") == frame.stamp
    with pytest.raises(MessageError, match="FrameStamp"):
        decode_stamp(StereoFrame, b"\x0a\x02\xff\xff")


@pytest.mark.slow
@settings(max_examples=60)
@given(message=any_message, data=st.data())
def test_damaged_bytes_are_a_message_or_a_message_error(message, data):
    damaged = bytearray(encode(message))
    for _ in range(data.draw(st.integers(0, 4)) if damaged else 0):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    kept = damaged[: data.draw(st.just(len(damaged)) | st.integers(0, len(damaged)))]
    decoded_or_refused(data.draw(st.just(type(message)) | message_types), bytes(kept))
    decoded_or_refused(type(message), data.draw(st.binary(max_size=200)))


@settings(max_examples=40)
@given(message=any_message, garbage=st.binary(min_size=1, max_size=30))
def test_trailing_garbage_never_passes_unnoticed(message, garbage):
    # garbage may happen to be well-formed known fields, which then are part of the message by protobuf's rules
    found = decoded_or_refused(type(message), encode(message) + garbage)
    if found is not None:
        reparsed = wire_type(type(message)).FromString(encode(message) + garbage)
        if type(message) not in LEADING_TO_MOTION:
            reparsed.DiscardUnknownFields()
        assert encode(found) == reparsed.SerializeToString(deterministic=True)


def test_the_encoding_name_is_the_protobuf_type():
    assert encoding_name(StereoFrame) == "application/protobuf;suturegrasp.v1.StereoFrame"


def observed():
    """A small set of observations as its protobuf twin, ready to be spoilt."""
    mask = Image(ImageEncoding.RAW, 2, 1, 1, b"\0\xff")
    message = ThreadObservations(
        stamp=FrameStamp(7, 10, 11, "c"),
        camera=RectifiedStereo(2, 1, 100.0, 100.0, 1.0, 0.5, 5.0, None),
        status=Status.OK,
        reason="",
        segmenter="truth",
        points_camera=np.array([[0.0, 0.0, 10.0], [1.0, 0.0, 11.0]]),
        half_size_px=np.ones((2, 2)),
        matched_px=np.ones((3, 3)),
        match_cost=np.ones((3, 2)),
        inlier=np.array([True, False, True]),
        mask_left=mask,
        mask_right=mask,
        judgements=(Judgement("ROWS", Severity.NOTE, "f", "r"),),
    )
    return wire_type_named("ThreadObservations").FromString(encode(message))


SPOILT = {
    "no stamp": (lambda m: m.ClearField("stamp"), "ThreadObservations.stamp is missing"),
    "no array": (lambda m: m.ClearField("inlier"), "ThreadObservations.inlier is missing"),
    "no status": (lambda m: m.ClearField("status"), "ThreadObservations.status is unspecified; .* 1 [(]OK[)], 2"),
    "unknown severity": (
        lambda m: setattr(m.judgements[0], "severity", 77),
        r"ThreadObservations.judgements\[0\].severity has the unknown value 77",
    ),
    "wrong dtype": (
        lambda m: setattr(m.points_camera, "dtype", ">f8"),
        "ThreadObservations.points_camera must hold <f8, not '>f8'",
    ),
    "too few bytes": (
        lambda m: setattr(m.half_size_px, "data", b"\0" * 31),
        r"ThreadObservations.half_size_px holds 31 bytes where its shape \(2, 2\) needs 32",
    ),
    "a hostile shape": (
        lambda m: m.inlier.shape.__setitem__(0, 2**32 - 1),
        "ThreadObservations.inlier holds 3 bytes where its shape .* needs 4294967295",
    ),
    "too many axes": (
        lambda m: m.inlier.shape.extend([2**32 - 1] * 1000),
        r"ThreadObservations.inlier must have shape \(p\)",
    ),
    "the wrong fixed axis": (
        lambda m: m.points_camera.shape.__setitem__(slice(None), [3, 2]),
        r"points_camera must have shape \(n, 3\), not \(3, 2\)",
    ),
    "no booleans": (lambda m: setattr(m.inlier, "data", b"\0\1\2"), "inlier holds bytes that are neither true"),
    "not a number": (
        lambda m: setattr(m.match_cost, "data", np.full((3, 2), np.nan).tobytes()),
        "ThreadObservations.match_cost must be finite",
    ),
    "a nested message that contradicts itself": (
        lambda m: setattr(m.mask_left, "data", b""),
        "ThreadObservations.mask_left: Image.data holds 0 bytes",
    ),
    "an array's field from the future": (
        lambda m: m.inlier.MergeFromString(b"\xf8\x3f\x01"),
        "ThreadObservations.inlier has fields that this version does not know",
    ),
}


@pytest.mark.parametrize(("spoil", "text"), SPOILT.values(), ids=SPOILT)
def test_the_error_names_the_field_and_the_fault(spoil, text):
    wire = observed()
    decode(ThreadObservations, wire.SerializeToString())
    spoil(wire)
    with pytest.raises(MessageError, match=text):
        decode(ThreadObservations, wire.SerializeToString())


def added(number):
    """A field of that number, which holds 1."""
    key, out = number << 3, bytearray()
    while key > 0x7F:
        out.append(key & 0x7F | 0x80)
        key >>= 7
    return bytes([*out, key, 1])


def test_whatever_could_move_a_robot_or_says_where_it_goes_is_understood_in_full():
    assert {message_type.__name__ for message_type in LEADING_TO_MOTION} == {
        *("GraspGoal", "GraspPlan", "Arm", "ChangeState", "Heartbeat"),
        *("ReplayClock", "SetParameter", "ToolCorrection", "FrameNotice"),
    }


@every_message_type
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


def test_what_a_newer_version_added_within_a_plan_is_refused_and_within_observations_left_out():
    wire = observed()
    wire.camera.MergeFromString(added(900))
    assert decode(ThreadObservations, wire.SerializeToString()).camera.fx_px == 100.0
    goal = wire_type_named("GraspGoal")()
    goal.header.MergeFromString(added(900))
    with pytest.raises(MessageError, match=r"GraspGoal.header has fields that this version does not know"):
        decode(GraspGoal, goal.SerializeToString())


TEXT_FOR_A_NUMBER = encode(Consumed("k", 1, 2)) + b"\x12\x01x"


@pytest.mark.parametrize(
    ("message_type", "data", "said"),
    [
        (StereoFrame, b"", r"StereoFrame\.stamp is missing"),
        (StereoFrame, b"\x0a\x7f", "StereoFrame cannot be read: its 2 bytes are damaged or of another type"),
        (Judgement, b"\x0a\x02\xff\xfe", "Judgement cannot be read"),
        (Image, bytes(MAX_MESSAGE_BYTES + 1), "Image is too large"),
        (Consumed, TEXT_FOR_A_NUMBER, r"Consumed has fields that this version does not know \(numbers 2\)"),
    ],
    ids=["no bytes", "an unfinished field", "text that is not UTF-8", "too many bytes", "a field of another kind"],
)
def test_bytes_that_are_no_message_are_refused(message_type, data, said):
    with pytest.raises(MessageError, match=said):
        decode(message_type, data)


def test_absurd_but_finite_numbers_are_refused_quietly():
    wire = wire_type_named("StereoCalibration")(image_width=2, image_height=2)
    for name, value in (("K_left", np.eye(3)), ("K_right", np.eye(3)), ("T_right_left", np.eye(4) * 1e300)):
        value[-1, -1] = 1
        getattr(wire, name).MergeFrom(wire_type_named("Array")(dtype="<f8", shape=value.shape, data=value.tobytes()))
    for name in ("distortion_left", "distortion_right"):
        getattr(wire, name).MergeFrom(wire_type_named("Array")(dtype="<f8", shape=[0], data=b""))
    with pytest.raises(MessageError, match="not orthonormal"):
        decode(StereoCalibration, wire.SerializeToString())


def test_what_does_not_fit_its_field_cannot_be_sent():
    with pytest.raises(MessageError, match=r"FrameStamp\.capture_left_ns cannot be sent"):
        encode(FrameStamp(1, 2**63, 0, "c"))
    message = decode(ThreadObservations, observed().SerializeToString())
    half_a_surrogate_pair = Judgement("\ud800", Severity.NOTE, "f", "r")
    with pytest.raises(MessageError, match=r"ThreadObservations\.judgements\[0\]\.code cannot be sent"):
        encode(dataclasses.replace(message, judgements=(half_a_surrogate_pair,)))


def test_an_array_in_another_byte_order_or_with_strides_arrives_with_its_values():
    message = decode(ThreadObservations, observed().SerializeToString())
    swapped = dataclasses.replace(message, points_camera=message.points_camera.astype(">f8"))
    assert np.array_equal(decode(ThreadObservations, encode(swapped)).points_camera, message.points_camera)
    strided = np.arange(1.0, 13.0).reshape(2, 6)[:, ::2]
    sent = dataclasses.replace(message, points_camera=strided)
    assert np.array_equal(decode(ThreadObservations, encode(sent)).points_camera, strided)


def test_text_of_every_printable_character_survives():
    judgement = Judgement(string.printable, Severity.FAULT, "ε_z = 1.5 |L(o) − o|", "縫合糸")
    assert decode(Judgement, encode(judgement)) == judgement
