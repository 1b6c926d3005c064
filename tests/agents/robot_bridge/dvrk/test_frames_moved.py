"""A camera, set-up joints or a clutch that move invalidate what was seen before, arming and motion; told by topics."""

import numpy as np
import pytest

from agents.dvrk_emulator.messages import Joy, header
from agents.robot_bridge.dvrk.frames_moved import (
    ECM_AGE_NS,
    LOCAL,
    MEASURED,
    SETTLED_NS,
    TIP,
    FramesWatch,
    SinceRegistration,
)
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


def touched(watch, button):
    for pressed in (1, 0):
        watch.hear_button(f"PSM1/io/{button}", Joy(header(0), [], [pressed]).serialize())


def stands(watch, at_ns, T_reference_base=T_CAMERA_BASE, kinds=(TIP, MEASURED, LOCAL), apart_ns=0):
    """Have poses told of a camera that stands, and of a base that does."""
    poses = {TIP: T_CAMERA_BASE, MEASURED: T_reference_base, LOCAL: np.eye(4)}
    for kind in kinds:
        watch.hear_pose(kind, crtk.pose_command(poses[kind], at_ns + (apart_ns if kind == LOCAL else 0)), at_ns)


def test_poses_of_two_times_are_not_compared_and_a_button_counts_where_it_was_pressed_for_a_moment():
    watch = FramesWatch("PSM1", None)
    stands(watch, AT)
    assert watch.judge(AT) == ""
    stands(watch, AT + 10**7, exp_se3(np.full(6, 0.1)), (MEASURED, LOCAL), apart_ns=5_000_000)
    assert watch.judge(AT + 10**7) == ""
    touched(watch, "manip_clutch")
    assert "PSM1/io/manip_clutch was pressed" in watch.judge(AT)
    assert watch.judge(AT + SETTLED_NS) == ""


@pytest.mark.parametrize(
    ("comes", "why"),
    [
        ({"kinds": (MEASURED, LOCAL)}, "comes no more"),
        ({"kinds": (TIP, LOCAL)}, "is told no more"),
        ({"kinds": (TIP, MEASURED)}, "is told no more"),
        ({"apart_ns": 5_000_000}, "is told no more"),
    ],
)
def test_what_was_told_of_camera_or_base_and_comes_no_more_speaks_against_moving(comes, why):
    watch = FramesWatch("PSM1", None)
    stands(watch, AT)
    assert watch.judge(AT) == ""
    told, now_ns = "", AT
    for later in range(1, 4):
        now_ns = AT + later * ECM_AGE_NS // 2
        stands(watch, now_ns, **comes)
        told = watch.judge(now_ns)
    assert why in told
    stands(watch, now_ns)
    assert watch.judge(now_ns) == "", "it comes again, and stands where it stood"
    watch.hear_pose(TIP, b"", now_ns)
    assert "comes no more" in watch.judge(now_ns), "what cannot be read tells nothing"


def test_a_bridge_that_begins_anew_still_holds_what_moved_against_the_same_registration(tmp_path):
    def begun(registration="one"):
        return FramesWatch("PSM1", None, SinceRegistration(tmp_path / "kept" / f"{registration}.json"))

    watch = begun()
    stands(watch, AT)
    assert watch.judge(AT) == ""
    moved = T_CAMERA_BASE @ exp_se3(np.array((0.005, 0, 0, 0, 0, 0)))
    watch = begun()
    stands(watch, AT, moved)
    assert "the base, by its set-up joints or the camera's, is 5.0 mm" in watch.judge(AT), "moved while nobody heard"
    watch = begun("two")
    stands(watch, AT, moved)
    assert watch.judge(AT) == ""
    touched(watch, "suj_clutch")
    for _ in range(2):
        stands(watch, AT + 20 * SETTLED_NS, moved)
        assert "register the base anew" in watch.judge(AT + 20 * SETTLED_NS)
        watch = begun("two")
    assert "register the base anew" not in begun("three").judge(AT)
    watch = begun()
    stands(watch, AT, moved)
    assert "is 5.0 mm" in watch.judge(AT), "another registration in between changes nothing"
    (tmp_path / "kept" / "two.json").write_text("{")
    assert "cannot be read" in begun("two").judge(AT)


def test_where_what_moved_cannot_be_kept_nothing_moves_until_it_is(tmp_path):
    full = tmp_path / "kept"
    full.write_text("a file where a folder should be")
    watch = FramesWatch("PSM1", None, SinceRegistration(full / "one.json"))
    stands(watch, AT)
    touched(watch, "suj_clutch")
    assert "cannot be written" in watch.judge(AT)
    full.unlink()
    assert "register the base anew" in watch.judge(AT)
    again = FramesWatch("PSM1", None, SinceRegistration(full / "one.json"))
    assert "register the base anew" in again.judge(AT), "it was written once there was room"


@pytest.mark.parametrize("fixed", [True, False])
def test_a_base_whose_set_up_joints_move_is_told_from_a_camera_that_does(fixed):
    """Whichever frame the console tells the arm in: a fixed one, or that of the endoscope's tip."""
    tip, further = exp_se3(np.array((0.01, 0.02, -0.1, 0.2, 0, 0))), exp_se3(np.array((0, 0, 0.01, 0, 0.05, 0)))
    watch = FramesWatch("PSM1", HandEye(tip @ FLIP @ T_CAMERA_BASE, Reference.ECM_BASE))

    def judged(tip, base, at_ns):
        watch.hear_pose(TIP, crtk.pose_command(tip, at_ns), at_ns)
        watch.hear_pose(MEASURED, crtk.pose_command(base if fixed else inverse(tip) @ base, at_ns), at_ns)
        watch.hear_pose(LOCAL, crtk.pose_command(np.eye(4), at_ns), at_ns)
        return watch.judge(at_ns)

    base = exp_se3(np.array((0.1, 0.0, 0.2, 0, 0.3, 0)))
    assert judged(tip, base, AT) == ""
    assert "the camera (ECM) moved" in judged(tip @ further, base, AT + SETTLED_NS)
    assert judged(tip @ further, base, AT + 3 * SETTLED_NS) == "", "the camera is followed"
    moved = exp_se3(np.array((0.05, 0, 0, 0, 0, 0))) @ base
    assert "the base, by its set-up joints, is" in judged(tip @ further, moved, AT + 4 * SETTLED_NS)


def test_both_poses_of_one_time_are_compared_though_a_turn_falls_between_them():
    watch, now_ns = FramesWatch("PSM1", None), AT
    for turn in range(2 * ECM_AGE_NS // 10**7):
        now_ns = AT + turn * 10**7
        stands(watch, now_ns, kinds=(TIP, MEASURED))
        watch.hear_pose(LOCAL, crtk.pose_command(np.eye(4), now_ns - 10**7), now_ns)
        assert watch.judge(now_ns) == ""
    stands(watch, now_ns + 10**7, T_CAMERA_BASE @ exp_se3(np.array((0.005, 0, 0, 0, 0, 0))), (MEASURED,))
    stands(watch, now_ns + 10**7, kinds=(LOCAL,))
    assert "set-up joints or the camera's, is 5.0 mm" in watch.judge(now_ns + 10**7)


def test_a_button_that_is_told_to_be_up_as_a_console_starts_let_go_of_nothing():
    watch = FramesWatch("PSM1", None)
    watch.hear_button("PSM1/io/suj_clutch", Joy(header(0), [], [0]).serialize())
    assert "was pressed" in watch.judge(AT)
    assert watch.judge(AT + SETTLED_NS) == ""


def test_a_clock_that_is_set_back_makes_no_frame_of_afterwards_one_of_before():
    watch = FramesWatch("PSM1", None)
    touched(watch, "manip_clutch")
    watch.judge(AT)
    watch.judge(AT - 60 * SECOND_NS)
    assert watch.still_since_ns == AT - 60 * SECOND_NS
