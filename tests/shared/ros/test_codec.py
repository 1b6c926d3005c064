"""Our messages against those of another library, which the emulated console speaks, byte for byte."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.emulator import messages as others
from shared.rigid_transforms import rotation_from_quaternion
from shared.ros import crtk, types
from shared.ros.naming import RmwZenoh, Role, Ros2dds
from tests.rigs.robot.messages import KINDS, PYCDR2, compared

NUMBER = st.floats(allow_nan=False, allow_infinity=False, width=64)
NS = st.integers(0, 2**31 * 10**9 - 1)
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=30)
PUBLISHED = {
    types.JOINT_STATE: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    types.STRING: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    types.IMAGE: "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    types.CAMERA_INFO: "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275",
}
"""As ROS installations print them."""


@settings(deadline=None)
@given(NS, st.lists(NUMBER, min_size=1, max_size=9))
def test_commands_are_the_same_bytes_in_either_library(stamp_ns, position):
    assert crtk.empty() == others.Empty().serialize()
    assert crtk.state_command("home", stamp_ns) == others.StringStamped(others.header(stamp_ns), "home").serialize()
    theirs = others.JointState(others.header(stamp_ns), [], position, [], []).serialize()
    assert crtk.joint_command(np.array(position), stamp_ns) == theirs
    read = crtk.joints(theirs)
    assert (read.stamp_ns, read.position.tolist()) == (stamp_ns, position)


@settings(deadline=None)
@given(NS, TEXT, st.lists(TEXT, max_size=7), st.lists(NUMBER, max_size=7), st.booleans(), st.booleans())
def test_what_the_console_says_is_read_as_it_was_said(stamp_ns, word, names, numbers, one, other):
    at = others.header(stamp_ns, word)
    stated = others.JointState(at, names, numbers, numbers[:1], [])
    assert crtk.joints(stated.serialize()).position.tolist() == numbers
    state = others.OperatingState(at, word, one, other)
    assert crtk.operating_state(state.serialize()) == (word, one, other)
    assert crtk.text(others.String(word).serialize()) == word
    for name, theirs in (
        (types.JOINT_STATE, stated),
        (types.OPERATING_STATE, state),
        (types.STRING_STAMPED, others.StringStamped(at, word)),
        (types.STRING, others.String(word)),
        (types.BOOL, others.Bool(one)),
    ):
        data = theirs.serialize()
        assert types.encode(name, types.decode(name, data)) == data


@settings(deadline=None)
@given(
    NS, TEXT, st.lists(st.floats(-10, 10), min_size=3, max_size=3), st.lists(st.floats(-1, 1), min_size=4, max_size=4)
)
def test_a_pose_is_read_as_it_was_said(stamp_ns, frame, place, turned):
    norm = float(np.linalg.norm(turned))
    if norm < 1e-3:
        return
    w, x, y, z = (value / norm for value in turned)
    theirs = others.PoseStamped(
        others.header(stamp_ns, frame), others.Pose(others.Point(*place), others.Quaternion(x, y, z, w))
    ).serialize()
    read = crtk.pose(theirs)
    assert (read.stamp_ns, read.frame, read.T[:3, 3].tolist()) == (stamp_ns, frame, place)
    assert np.abs(read.T[:3, :3] - rotation_from_quaternion(np.array((w, x, y, z)))).max() < 1e-12
    assert types.encode(types.POSE_STAMPED, types.decode(types.POSE_STAMPED, theirs)) == theirs


@settings(deadline=None)
@given(st.binary(max_size=120), st.sampled_from((crtk.joints, crtk.pose, crtk.operating_state, crtk.text)))
def test_bytes_that_are_no_message_are_refused_in_words(data, read):
    try:
        read(types.LITTLE_ENDIAN + data)
    except types.RosMessageError as error:
        assert str(error)


@pytest.mark.parametrize("name", KINDS)
def test_every_message_that_is_used_is_the_same_bytes_in_either_library(name):
    row = compared(5, name)[0]
    assert row[PYCDR2] == 5


def test_what_is_cut_off_or_makes_no_sense_is_refused():
    whole = others.JointState(others.header(5), ["yaw"], [1.0, 2.0], [], []).serialize()
    for length in (0, 3, 4, 20, len(whole) - 9):
        with pytest.raises(types.RosMessageError, match="JointState"):
            crtk.joints(whole[:length])
    flat = others.PoseStamped(pose=others.Pose(orientation=others.Quaternion(0.0, 0.0, 0.0, 0.0)))
    for faulty in (flat, others.PoseStamped(pose=others.Pose(others.Point(float("nan"), 0.0, 0.0)))):
        with pytest.raises(types.RosMessageError, match="pose"):
            crtk.pose(faulty.serialize())
    for position in ([], [float("nan")], [float("inf"), 1.0]):
        with pytest.raises(ValueError, match="finite"):
            crtk.joint_command(np.array(position), 0)


def test_hashes_of_types_are_those_that_ros_publishes():
    assert {name: types.type_hash(name) for name in PUBLISHED} == PUBLISHED


def test_keys_attachments_and_tokens_are_as_the_two_kinds_of_zenoh_expect():
    bridge, rmw = Ros2dds(), RmwZenoh(domain=3)
    assert bridge.key("PSM1/servo_jp", types.JOINT_STATE) == "PSM1/servo_jp"
    assert bridge.attachment(1, 2, bytes(16)) is None
    assert bridge.token("z", 1, Role.PUBLISHER, "PSM1/servo_jp", types.JOINT_STATE, False) is None
    head, hashed = "sensor_msgs::msg::dds_::JointState_", PUBLISHED[types.JOINT_STATE]
    assert rmw.key("PSM1/servo_jp", types.JOINT_STATE) == f"3/PSM1/servo_jp/{head}/{hashed}"
    assert RmwZenoh(0, False).key("a", types.STRING) == "0/a/std_msgs::msg::dds_::String_/TypeHashNotSupported"
    assert (
        rmw.attachment(1, -1, b"0123456789abcdef")
        == bytes.fromhex(f"0100000000000000{'f' * 16}10") + b"0123456789abcdef"
    )
    token = rmw.token("abc", 11, Role.PUBLISHER, "PSM1/servo_jp", types.JOINT_STATE, False)
    assert token == f"@ros2_lv/3/abc/0/11/MP/%/%/suturegrasp/%PSM1%servo_jp/{head}/{hashed}/::,10:,:,:,,"
    assert rmw.token("abc", 0, Role.NODE, "", "", False) == "@ros2_lv/3/abc/0/0/NN/%/%/suturegrasp"
