"""A real arm: what must be known of where it stands before it moves, and who must stand by while it does."""

import dataclasses

import pytest

from agents.robot_bridge.agent import RobotBridgeConfig
from schemas.messages import ExecutionKind, RobotMode
from tests.agents.robot_bridge.drive import EPOCH, SECOND, Drive, UnreliableArm, plan, tissue_before

DAY = 86_400 * SECOND
KNOWN = RobotBridgeConfig(calibration_id="c", registered_ns=EPOCH, tissue_needed=False)
"""All that a real arm needs to be known of."""


class RealArm(UnreliableArm):
    is_real = True


def real(**changes):
    return Drive(dataclasses.replace(KNOWN, **changes), RealArm(), camera=0)


def publish(drive, calibration_id="c"):
    """A plan of a frame that is taken now, by a camera with that calibration."""
    drive.see()
    drive.publish(plan(stamp=dataclasses.replace(drive.stamp(), calibration_id=calibration_id)))


@pytest.mark.parametrize(
    ("changes", "calibration_id", "code", "why"),
    [
        ({}, "c", "", ""),
        ({}, "", "wrong_frame", "the arm was registered in that of c"),
        ({"calibration_id": ""}, "", "unknown", "the plan's frame does not say of which camera calibration it is"),
        ({"calibration_id": ""}, "c", "unknown", 'set T_camera_base_calibration = "c"'),
        ({"registered_ns": 0}, "c", "unknown", "nobody says when the arm was registered"),
        ({"registered_ns": EPOCH - 29 * DAY}, "c", "", ""),
        ({"registered_ns": EPOCH - 31 * DAY}, "c", "unknown", "was registered 31 days ago, and 30 are allowed"),
        ({"registered_ns": EPOCH + 2 * DAY}, "c", "unknown", "2 days ahead of this host's clock"),
        ({"tissue_needed": True}, "c", "unknown", "where the tissue is was not measured"),
    ],
)
def test_what_is_not_known_of_where_a_real_arm_stands_speaks_against_arming_it(changes, calibration_id, code, why):
    drive = real(**changes)
    publish(drive, calibration_id)
    answer = drive.arm(pressed=True)
    assert (answer.code, why in answer.reason) == (code, True)


@pytest.mark.parametrize(("age_s", "code"), [(0.5, ""), (1.5, "unknown")])
def test_tissue_that_was_measured_too_long_ago_is_none(age_s, code):
    drive = real(tissue_needed=True, maximum_plan_age_s=1.0)
    tissue_before(drive, 0.2)
    drive.tick(round(age_s * SECOND))
    publish(drive)
    assert drive.arm(pressed=True).code == code


@pytest.mark.parametrize(("by", "code"), [("press", "heartbeat_lost"), ("pedal", "no_presence")])
def test_a_process_that_beats_keeps_no_real_arm_moving_once_press_or_pedal_is_released(by, code):
    drive = real()
    drive.backend.tell(pedal=by == "pedal")
    drive.tick()
    publish(drive)
    assert drive.arm(pressed=by == "press").code == ""
    drive.run(30, pressed=by == "press")
    assert drive.states[-1].mode is RobotMode.MOVING
    drive.backend.tell(pedal=False)
    drive.run(30)
    assert drive.ended == (ExecutionKind.HELD, code)
