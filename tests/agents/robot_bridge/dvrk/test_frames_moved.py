"""A camera, set-up joints or a clutch that move invalidate what was seen before, arming and motion; told by topics."""

import numpy as np
import pytest

from agents.dvrk_emulator.messages import Joy, header
from agents.robot_bridge.dvrk.frames_moved import LOCAL, MEASURED, SETTLED_NS, TIP, FramesWatch
from schemas.messages import ExecutionKind
from shared.calibration.hand_eye.file import FLIP, HandEye, Reference
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T_CAMERA_BASE
from shared.rigid_transforms import exp_se3, inverse
from shared.ros import crtk

SECOND_NS = 10**9
AT = 100 * SECOND_NS


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
    watch = FramesWatch("PSM1", HandEye(tip @ FLIP @ T_CAMERA_BASE, Reference.ECM_BASE))
    assert "told from the ECM" in watch.judge(AT)
    watch.hear_pose(TIP, crtk.pose_command(tip, 0), AT)
    assert watch.judge(AT) == ""
    assert watch.T_camera_base is not None
    np.testing.assert_allclose(watch.T_camera_base, T_CAMERA_BASE, atol=1e-9)
    watch.hear_pose(TIP, crtk.pose_command(tip @ further, 0), AT)
    assert "the camera (ECM) moved" in watch.judge(AT)
    assert watch.still_since_ns == AT
    assert watch.judge(AT + SETTLED_NS) == ""
    assert watch.T_camera_base is not None
    np.testing.assert_allclose(watch.T_camera_base, FLIP @ inverse(further) @ FLIP @ T_CAMERA_BASE, atol=1e-9)
    assert "does not come" in watch.judge(AT + 2 * SECOND_NS)


def test_poses_of_two_times_tell_nothing_and_released_set_up_joints_stay_told():
    def touched(button):
        for pressed in (1, 0):
            watch.hear_button(f"PSM1/io/{button}", Joy(header(0), [], [pressed]).serialize())

    watch = FramesWatch("PSM1", None)
    watch.hear_pose(LOCAL, crtk.pose_command(np.eye(4), 0), AT)
    watch.hear_pose(MEASURED, crtk.pose_command(np.eye(4), 0), AT)
    assert watch.judge(AT) == ""
    watch.hear_pose(MEASURED, crtk.pose_command(exp_se3(np.full(6, 0.1)), 5_000_000), AT)
    watch.hear_pose(TIP, b"", AT)
    assert watch.judge(AT) == ""
    touched("manip_clutch")
    assert "PSM1/io/manip_clutch was pressed" in watch.judge(AT), "also where it was pressed for a moment"
    assert watch.judge(AT + SETTLED_NS) == ""
    touched("suj_clutch")
    for later in (10, 20):
        assert "register the base anew" in watch.judge(AT + later * SETTLED_NS)
