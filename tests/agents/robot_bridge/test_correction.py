"""A base that the images correct: what speaks against a motion with it, before it begins and while it lasts."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.correction import CorrectionLimits
from schemas.messages import CommandAnswer, ExecutionKind, FrameStamp, ToolCandidate, ToolCorrection, ToolStatus
from schemas.topics import TOOL
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import exp_so3, transform
from tests.agents.robot_bridge.drive import EPOCH, SECOND, Drive, plan, stands_still


def looked(captured_ns: int, off_mm: float = 5.0, turned_deg: float = 0.0, **changes: Any) -> ToolCorrection:
    """Perception tells that the tool is so far off, by a frame of then."""
    tip = np.array((0.01, 0.0, 0.06))
    corrected = tip + np.array((1e-3 * off_mm, 0.0, 0.0))
    R = exp_so3(np.radians((0.0, 0.0, turned_deg)))
    none = np.zeros((0, 2))
    told = ToolCorrection(
        arm="psm1",
        stamp=FrameStamp(1, captured_ns, captured_ns, "c"),
        measured_ns=captured_ns,
        status=ToolStatus.CONVERGED,
        reason="",
        T_correction=transform(R, corrected - R @ tip),
        pivot_camera=tip,
        tip_camera=corrected,
        tip_off_m=1e-3 * off_mm,
        turned_rad=float(np.radians(turned_deg)),
        tip_deviation_m=0.0005,
        turn_deviation_rad=0.01,
        registered_left_px=none,
        found_left_px=none,
        found_right_px=none,
        candidates=(ToolCandidate(np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 90, 0.9, 0.8, 0.5),),
        attempts=0,
        misses=0,
        looks=1,
    )
    return dataclasses.replace(told, **changes)


class Corrected(Drive):
    """A bridge whose base is corrected by the images."""

    def __init__(self, **config: Any) -> None:
        super().__init__(RobotBridgeConfig(correction=CorrectionLimits(), **config))

    def look(self, age_s: float = 0.1, **changes: Any) -> None:
        self.hear(TOOL, looked(self.now_ns - round(age_s * SECOND), **changes))
        self.tick()

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick()

    def arm_now(self) -> CommandAnswer:
        self.publish(plan(captured_ns=self.now_ns))
        return self.arm()


LOST: dict[str, Any] = {
    "status": ToolStatus.LOST,
    "reason": "it is not in view",
    "T_correction": None,
    "candidates": (),
}
MISSED: dict[str, Any] = {"misses": 1, "reason": "not seen", "T_correction": None}


@pytest.mark.parametrize(
    ("look", "code", "told"),
    [
        (None, "correction_lost", "nothing was told yet"),
        (LOST, "correction_lost", "it is not in view"),
        ({"tip_deviation_m": 0.002}, "correction_lost", "known to 2.0 mm only, where 1.5 mm are needed"),
        ({"off_mm": 16.0}, "correction_limit", "16.0 mm and 0.0 degrees off in the images, where 15 mm and 8 degrees"),
        ({"turned_deg": 9.0}, "correction_limit", "5.0 mm and 9.0 degrees off"),
        ({"age_s": 4.5}, "correction_lost", "seen 4.5 s ago in the images, and 4 s are allowed"),
        ({"age_s": -0.7}, "clock", "captured 0.7 s in the future: set the clocks"),
        ({"stamp": FrameStamp(1, EPOCH, EPOCH, "other")}, "wrong_frame", "and the tool was seen in that of other"),
    ],
)
def test_nothing_is_armed_where_the_images_do_not_tell_where_the_tool_is(look, code, told):
    drive = Corrected()
    if look is not None:
        drive.look(**look)
    answer = drive.arm_now()
    assert (answer.code, told in answer.reason) == (code, True)


@pytest.mark.parametrize(
    ("look", "code", "told"),
    [
        ({"off_mm": 9.0}, "correction_jumped", "4.0 mm and 0.0 degrees from where it was when its motion was planned"),
        ({"turned_deg": 4.0}, "correction_jumped", "4.0 degrees from where it was"),
        ({"off_mm": 20.0}, "correction_limit", "register anew"),
        ({"tip_deviation_m": 0.002}, "correction_lost", "known to 2.0 mm only"),
        (LOST, "correction_lost", "not followed in the images any more: it is not in view"),
        ({"age_s": -0.7}, "clock", "in the future"),
    ],
)
def test_a_motion_ends_where_the_images_tell_something_else_or_nothing_any_more(look, code, told):
    drive = Corrected()
    drive.look()
    assert drive.arm_now().code == ""
    drive.run(60)
    base = drive.states[-1].T_camera_base
    drive.look(off_mm=6.0)
    assert drive.bridge.executes
    np.testing.assert_array_equal(drive.states[-1].T_camera_base, base)
    drive.look(**look)
    assert drive.ended == (ExecutionKind.HELD, code)
    assert told in drive.events[-1].reason
    assert stands_still(drive)


def test_a_look_that_came_late_is_held_said_so_and_given_up():
    """At load a look is told seconds after its frame; perception then falls silent in mid-motion."""
    drive = Corrected(ratio=0.2)
    drive.ticks(100)
    looked_ns = drive.now_ns
    drive.ticks(250)
    drive.look(age_s=2.5)
    drive.ticks(10)
    assert drive.states[-1].correction_looked_ns == looked_ns
    assert drive.arm_now().code == "", "it has stood since"
    drive.run(130)
    assert drive.bridge.executes
    # one more view in which it was not seen is no reason yet, and no look either
    drive.look(**MISSED)
    assert drive.states[-1].correction_looked_ns == looked_ns
    drive.run(20)
    assert drive.ended == (ExecutionKind.HELD, "correction_lost")
    assert "4.0 s ago" in drive.events[-1].reason


@pytest.mark.parametrize(("waited_s", "refused"), [(0.5, False), (1.5, True)])
def test_an_arm_that_moved_since_it_was_seen_is_seen_again_unless_that_was_a_moment_ago(waited_s, refused):
    drive = Corrected()
    drive.look()
    state = drive.backend.state(drive.now_ns)
    drive.backend.move(state.joints + 0.01, state.jaw_rad, "a")
    drive.ticks(round(100 * waited_s))
    answer = drive.arm_now()
    assert (answer.code, "has moved since" in answer.reason) == ("correction_lost" if refused else "", refused)
    drive.look(age_s=waited_s - 0.3)
    assert drive.arm_now().code == ("" if refused else "busy")


def test_a_tool_that_was_seen_before_camera_or_arm_were_moved_by_hand_is_seen_again_first():
    drive = Corrected()
    drive.look()
    drive.backend.tell(still_since_ns=drive.now_ns)
    drive.ticks(25)
    answer = drive.arm_now()
    assert (answer.code, "moved by hand since the tool was seen" in answer.reason) == ("correction_lost", True)
    drive.look()
    assert drive.arm_now().code == ""


def test_a_base_is_told_as_the_images_correct_it_and_as_registered_where_nothing_does():
    drive = Corrected()
    drive.tick()
    state = drive.states[-1]
    assert (state.correction_looked_ns, state.T_camera_base_registered) == (0, None)
    np.testing.assert_array_equal(state.T_camera_base, SIMULATED_T_CAMERA_BASE)
    drive.look(off_mm=5.0)
    moved = drive.states[-1].T_camera_base - SIMULATED_T_CAMERA_BASE
    np.testing.assert_allclose(moved[:3, 3], (0.005, 0, 0), atol=1e-12)
    drive.look(**MISSED)
    registered = drive.states[-1].T_camera_base_registered
    np.testing.assert_array_equal(registered, SIMULATED_T_CAMERA_BASE, "one view in which it was not seen")
    for nothing in (LOST, {"off_mm": 16.0}):
        drive.look(off_mm=5.0)
        drive.look(**nothing)
        assert drive.states[-1].T_camera_base_registered is None
