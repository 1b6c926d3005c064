"""What the monitor reads and writes, against another library's bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.guard import cdr
from shared.ros import crtk
from shared.ros.types import JOINT_STATE, JOY, encode, message

numbers = st.lists(st.floats(allow_nan=False), max_size=9)
singles = st.lists(st.floats(width=32, allow_nan=False), max_size=5)
buttons = st.lists(st.integers(0, 1), min_size=1, max_size=60)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
stamps = st.integers(0, 2**31 * 10**9 - 1) | st.just(2**31 * 10**9 - 1)


def joy_of(*buttons, stamp_ns=1, frame="a", axes=(1.0,)):
    stamp = message("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
    header = message("std_msgs/msg/Header", stamp, frame)
    return encode(JOY, message(JOY, header, np.array(axes, np.float32), np.array(buttons, np.int32)))


@given(stamps, texts, st.lists(texts, max_size=7), numbers, numbers, numbers, singles, buttons)
def test_positions_and_buttons_are_read_from_any_message(
    stamp_ns, frame, names, position, velocity, effort, axes, down
):
    stamp = message("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
    arrays = (np.array(values, np.float64) for values in (position, velocity, effort))
    joints = message(JOINT_STATE, message("std_msgs/msg/Header", stamp, frame), names, *arrays)
    assert cdr.joint_positions(encode(JOINT_STATE, joints)) == tuple(position)
    assert cdr.pressed(joy_of(*down, stamp_ns=stamp_ns, frame=frame, axes=axes)) == (down[0] == 1)


@given(stamps, st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=7))
def test_what_is_written_are_the_other_librarys_bytes(stamp_ns, positions):
    assert cdr.joint_state(tuple(positions), stamp_ns) == crtk.joint_command(np.array(positions), stamp_ns)
    assert cdr.string_stamped("hold", stamp_ns) == crtk.state_command("hold", stamp_ns)
    assert crtk.empty() == cdr.EMPTY
    begun_anew_ns = stamp_ns + 2**31 * 10**9
    assert cdr.string_stamped("hold", begun_anew_ns) == crtk.state_command("hold", stamp_ns), "it fits its seconds"


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
    with pytest.raises(cdr.CdrError, match="not CDR in little endian"):
        read(b"\x00\x00" + whole[2:])


def test_a_long_list_and_a_joy_without_buttons_are_none_and_a_button_counts_while_it_is_down():
    assert len(cdr.joint_positions(crtk.joint_command(np.arange(64.0), 5))) == 64
    with pytest.raises(cdr.CdrError, match="claims to have 65 values"):
        cdr.joint_positions(crtk.joint_command(np.arange(65.0), 5))
    with pytest.raises(cdr.CdrError, match="no button"):
        cdr.pressed(joy_of())
    assert [cdr.pressed(joy_of(value)) for value in (-1, 0, 1, 2)] == [False, False, True, False]
