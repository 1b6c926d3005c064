"""Our messages against those of another library, which the emulated console speaks, byte for byte."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.dvrk_emulator import messages as others
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
@given(NS, TEXT, st.lists(NUMBER, min_size=1, max_size=9), st.booleans(), st.booleans())
def test_commands_and_what_the_console_says_are_the_same_in_either_library(stamp_ns, word, position, one, other):
    assert crtk.empty() == others.Empty().serialize()
    assert crtk.state_command("home", stamp_ns) == others.StringStamped(others.header(stamp_ns), "home").serialize()
    theirs = others.JointState(others.header(stamp_ns), [], position, [], []).serialize()
    assert crtk.joint_command(np.array(position), stamp_ns) == theirs
    at = others.header(stamp_ns, word)
    read = crtk.joints(others.JointState(at, [word], position, position[:1], []).serialize())
    assert (read.stamp_ns, read.position.tolist()) == (stamp_ns, position)
    assert crtk.operating_state(others.OperatingState(at, word, one, other).serialize()) == (word, one, other)
    assert crtk.text(others.String(word).serialize()) == word


@settings(deadline=None)
@given(NS, TEXT, st.tuples(*[st.floats(-10, 10)] * 3), st.tuples(st.floats(1e-3, 1), *[st.floats(-1, 1)] * 3))
def test_a_pose_is_read_as_it_was_said(stamp_ns, frame, place, turned):
    w, x, y, z = turned / np.linalg.norm(turned)
    pose = others.Pose(others.Point(*place), others.Quaternion(x, y, z, w))
    read = crtk.pose(others.PoseStamped(others.header(stamp_ns, frame), pose).serialize())
    assert (read.stamp_ns, read.frame, tuple(read.T[:3, 3])) == (stamp_ns, frame, place)
    assert np.abs(read.T[:3, :3] - rotation_from_quaternion(np.array((w, x, y, z)))).max() < 1e-12


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


def test_hashes_of_types_are_those_that_ros_publishes_and_keys_attachments_and_tokens_as_either_zenoh_expects():
    assert {name: types.type_hash(name) for name in PUBLISHED} == PUBLISHED
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
