"""A camera, set-up joints or a clutch that move invalidate what was seen before, arming and motion; told by topics."""

import numpy as np
import pytest

from agents.robot_bridge.dvrk.frames_moved import LOCAL, MEASURED, SETTLED_NS, TIP, FramesWatch
from schemas.messages import ExecutionKind
from shared.calibration.hand_eye.file import FLIP, HandEye, Reference
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T_CAMERA_BASE
from shared.rigid_transforms import exp_se3, inverse, quaternion_from_rotation
from shared.ros.types import JOY, POSE_STAMPED, encode, message

SECOND_NS = 10**9


def header(stamp_ns):
    stamp = message("builtin_interfaces/msg/Time", *divmod(stamp_ns, SECOND_NS))
    return message("std_msgs/msg/Header", stamp, "")


def posed(T, stamp_ns=0):
    w, x, y, z = quaternion_from_rotation(T[:3, :3])
    place = message("geometry_msgs/msg/Point", *T[:3, 3])
    turn = message("geometry_msgs/msg/Quaternion", x, y, z, w)
    return encode(POSE_STAMPED, message(POSE_STAMPED, header(stamp_ns), message("geometry_msgs/msg/Pose", place, turn)))


def joy(pressed):
    return encode(JOY, message(JOY, header(0), np.zeros(0, np.float32), np.array([pressed], np.int32)))


@pytest.mark.parametrize(
    ("word", "back", "reason"),
    [
        ("camera", "camera_back", "the camera (ECM) is 5.0 mm"),
        ("setup", "setup_back", "the base, by its set-up joints or the camera's, is 5.0 mm"),
        ("clutch", "unclutch", "footpedals/clutch was pressed"),
    ],
)
def test_what_moves_ends_the_motion_and_makes_plans_of_before_worth_nothing(room, word, back, reason):
    old = room.plan()
    room.starts_moving()
    room.console.request(word)
    room.until(lambda: room.events[-1].kind is ExecutionKind.HELD)
    assert reason in room.events[-1].reason
    assert room.verdict()["held_ns"] >= room.events[-1].at_ns
    assert room.verdict()["unsafe"] == 0
    room.console.request(back)
    room.ready()
    room.publish(old)
    assert room.arm_again().code == "moved"
    assert room.try_to_arm().code == "", "a plan of a newer frame"


def test_a_base_that_is_told_from_the_ecm_follows_it():
    tip, further = exp_se3(np.array((0.01, 0.02, -0.1, 0.2, 0, 0))), exp_se3(np.array((0, 0, 0.01, 0, 0.05, 0)))
    base = HandEye(tip @ FLIP @ T_CAMERA_BASE, Reference.ECM_BASE)
    watch, at = FramesWatch("PSM1", base), 100 * SECOND_NS
    assert "told from the ECM" in watch.judge(at)
    watch.hear_pose(TIP, posed(tip), at)
    assert watch.judge(at) == ""
    assert watch.T_camera_base is not None
    np.testing.assert_allclose(watch.T_camera_base, T_CAMERA_BASE, atol=1e-9)
    watch.hear_pose(TIP, posed(tip @ further), at)
    assert "the camera (ECM) moved" in watch.judge(at)
    assert watch.still_since_ns == at
    assert watch.judge(at + SETTLED_NS) == ""
    assert watch.T_camera_base is not None
    np.testing.assert_allclose(watch.T_camera_base, FLIP @ inverse(further) @ FLIP @ T_CAMERA_BASE, atol=1e-9)
    assert "does not come" in watch.judge(at + 2 * SECOND_NS)


def test_poses_of_two_times_tell_nothing_and_released_set_up_joints_stay_told():
    watch, at = FramesWatch("PSM1", None), 100 * SECOND_NS
    watch.hear_pose(LOCAL, posed(np.eye(4)), at)
    watch.hear_pose(MEASURED, posed(np.eye(4)), at)
    assert watch.judge(at) == ""
    watch.hear_pose(MEASURED, posed(exp_se3(np.full(6, 0.1)), 5_000_000), at)
    watch.hear_pose(TIP, b"", at)
    assert watch.judge(at) == ""
    watch.hear_button("PSM1/io/manip_clutch", joy(1))
    watch.hear_button("PSM1/io/manip_clutch", joy(0))
    assert "PSM1/io/manip_clutch was pressed" in watch.judge(at), "also where it was pressed for a moment"
    assert watch.judge(at + SETTLED_NS) == ""
    watch.hear_button("PSM1/io/suj_clutch", joy(1))
    watch.hear_button("PSM1/io/suj_clutch", joy(0))
    assert "register the base anew" in watch.judge(at + 10 * SETTLED_NS)
    assert "register the base anew" in watch.judge(at + 20 * SETTLED_NS)
