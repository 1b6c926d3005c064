"""What the monitor reads and writes, against another library's bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.guard import cdr
from shared.ros import crtk
from shared.ros.types import JOINT_STATE, JOY, encode, message

numbers = st.lists(st.floats(allow_nan=False), max_size=9)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
stamps = st.integers(0, 2**31 * 10**9 - 1) | st.just(2**31 * 10**9 - 1)


def header(stamp_ns: int, frame: str):
    stamp = message("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
    return message("std_msgs/msg/Header", stamp, frame)


def joy_of(*buttons):
    return encode(JOY, message(JOY, header(1, "a"), np.zeros(1, np.float32), np.array(buttons, np.int32)))


@given(stamps, texts, st.lists(texts, max_size=7), numbers, numbers, numbers)
def test_positions_are_read_from_any_joint_state(stamp_ns, frame, names, position, velocity, effort):
    arrays = (np.array(values, np.float64) for values in (position, velocity, effort))
    data = encode(JOINT_STATE, message(JOINT_STATE, header(stamp_ns, frame), names, *arrays))
    assert cdr.joint_positions(data) == tuple(position)


@given(
    stamps,
    texts,
    st.lists(st.floats(width=32, allow_nan=False), max_size=5),
    st.lists(st.integers(0, 1), min_size=1, max_size=60),
)
def test_a_button_is_read_from_any_joy(stamp_ns, frame, values, buttons):
    joy = message(JOY, header(stamp_ns, frame), np.array(values, np.float32), np.array(buttons, np.int32))
    assert cdr.pressed(encode(JOY, joy)) == (buttons[0] == 1)


@given(stamps, st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=7))
def test_what_is_written_are_the_other_librarys_bytes(stamp_ns, positions):
    assert cdr.joint_state(tuple(positions), stamp_ns) == crtk.joint_command(np.array(positions), stamp_ns)
    for word in ("pause", "hold"):
        assert cdr.string_stamped(word, stamp_ns) == crtk.state_command(word, stamp_ns)
    assert crtk.empty() == cdr.EMPTY


@pytest.mark.parametrize("read", [cdr.joint_positions, cdr.pressed])
def test_a_message_that_is_cut_off_or_goes_on_is_none(read):
    whole = crtk.joint_command(np.arange(6.0), 5) if read is cdr.joint_positions else joy_of(1, 1)
    for length in range(len(whole)):
        with pytest.raises(cdr.CdrError):
            read(whole[:length])
    read(whole + bytes(7))
    with pytest.raises(cdr.CdrError, match="more follows"):
        read(whole + bytes(8))
    assert read(whole[:2] + b"\x00\x03" + whole[4:]) == read(whole), "options are left alone"
    for other in (b"\x00\x00", b"\x00\x03", b"\x01\x01"):
        with pytest.raises(cdr.CdrError, match="not CDR in little endian"):
            read(other + whole[2:])


def test_a_list_that_claims_to_be_long_is_none():
    assert len(cdr.joint_positions(crtk.joint_command(np.arange(64.0), 5))) == 64
    with pytest.raises(cdr.CdrError, match="claims to have 65 values"):
        cdr.joint_positions(crtk.joint_command(np.arange(65.0), 5))


def test_a_time_that_does_not_fit_its_seconds_begins_anew():
    late_ns = (2**31 + 5) * 10**9 + 7
    assert cdr.string_stamped("hold", late_ns) == crtk.state_command("hold", 5 * 10**9 + 7)


@pytest.mark.parametrize("value", [-1, 0, 2])
def test_a_button_that_is_tapped_or_released_is_not_pressed(value):
    assert cdr.pressed(joy_of(value)) is False


def test_a_joy_without_buttons_is_none():
    with pytest.raises(cdr.CdrError, match="no button"):
        cdr.pressed(joy_of())
