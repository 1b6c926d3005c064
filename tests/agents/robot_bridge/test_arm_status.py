"""What speaks against beginning a motion, of the plan, of the moment and, for a real arm, of what is not known."""

import dataclasses

import pytest

from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from schemas.messages import ExecutionKind, FrameStamp, Outcome, Phase, ReplayClock, RobotMode
from schemas.topics import FRAME_NOTICE, HEARTBEAT, PLAN, REPLAY_CLOCK, SURFACE, TAIL
from tests.agents.robot_bridge.drive import (
    EPOCH,
    SECOND,
    TICK,
    Drive,
    RealArm,
    UnreliableArm,
    moving,
    plan,
    rejected,
    stands_still,
    tissue_before,
    waypoint,
)

HELD = ExecutionKind.HELD
DAY = 86_400 * SECOND
KNOWN = RobotBridgeConfig(calibration_id="c", registered_ns=EPOCH, tissue_needed=False)
"""All that a real arm needs to be known of."""


# plans


def test_the_last_few_plans_are_known_however_many_come_for_others_or_are_rejected() -> None:
    drive = Drive()
    assert drive.refused()[0] == "unknown_plan"
    drive.publish(plan(), *(plan(f"q{i}", arm="psm2") for i in range(30)), *(rejected(f"r{i}") for i in range(30)))
    assert drive.arm().outcome is Outcome.ACCEPTED
    drive.hold()
    drive.publish(*(plan(f"p{index}") for index in range(2, 10)))
    code, reason = drive.refused()
    assert (code, "p1" in reason) == ("unknown_plan", True)
    assert drive.arm("p2").outcome is Outcome.ACCEPTED


def test_the_latest_plan_of_an_id_counts_and_one_for_another_arm_or_that_no_arm_can_follow_for_nothing() -> None:
    drive = Drive()
    nowhere = plan("p4", waypoints=(waypoint((1e306, 1e306, -1e306), 0, Phase.APPROACH),))
    drive.publish(plan(), rejected(), plan("p2", arm="psm2"), plan("p3"), nowhere)
    code, reason = drive.refused()
    assert (code, "the goal is not on the thread" in reason) == ("rejected_plan", True)
    drive.publish(plan())
    for command in ({"plan_id": "p2"}, {"plan_id": "p3", "arm": "psm2"}, {"plan_id": "p3", "instance": "psm2"}):
        assert drive.refused(**command)[0] == "other_arm"
    assert drive.refused(plan_id="p4")[0] == "workspace"
    assert drive.arm().outcome is Outcome.ACCEPTED


@pytest.mark.parametrize(
    ("captured_s", "code", "why"),
    [(-31, "stale", "31.0 s old"), (3, "clock", "3.0 s in the future"), (-29, "", ""), (0.4, "", "")],
)
def test_a_plan_from_an_old_frame_or_from_the_future_is_refused(captured_s: float, code: str, why: str) -> None:
    drive = Drive()
    drive.publish(plan(captured_ns=EPOCH + round(captured_s * SECOND)))
    answer = drive.arm()
    assert (answer.code, why in answer.reason) == (code, True)


def test_a_plan_from_before_another_plans_motion_is_out_of_order_and_the_same_one_goes_on() -> None:
    drive = moving()
    drive.publish(plan("p2"), plan("p3", captured_ns=drive.now_ns))
    assert drive.arm("p3").code == "busy"
    drive.hold()
    assert drive.refused()[0] == "hold_command", "it was asked before the hold"
    code, reason = drive.refused(plan_id="p2")
    assert (code, "before the motion of plan p1 began" in reason) == ("out_of_order", True)
    assert drive.arm().outcome is Outcome.ACCEPTED, "what was held goes on"
    drive.hold()
    drive.tick()
    assert drive.arm("p3").outcome is Outcome.ACCEPTED


@pytest.mark.parametrize(("registered", "measured"), [("other", ""), ("c", "other")])
def test_a_plan_in_another_cameras_frame_than_base_or_tissue_is_refused(registered: str, measured: str) -> None:
    drive = Drive(RobotBridgeConfig(calibration_id=registered))
    if measured:
        tissue_before(drive, 0.1, measured)
    drive.publish(plan(), plan("p2", stamp=FrameStamp(1, EPOCH, EPOCH, registered)))
    code, reason = drive.refused()
    what = "tissue was measured" if measured else "arm was registered"
    assert (code, f"calibration c, and the {what} in that of other" in reason) == ("wrong_frame", True)
    assert drive.arm("p2").code == ("wrong_frame" if measured else "")


def test_tissue_that_was_measured_before_something_was_moved_by_hand_speaks_for_and_against_nothing() -> None:
    drive = Drive()
    tissue_before(drive, 0.05)
    drive.publish(plan(captured_ns=drive.now_ns + TICK))
    assert drive.refused()[0] == "tissue"
    drive.backend.tell(still_since_ns=drive.now_ns)
    drive.publish(plan(captured_ns=drive.now_ns))
    assert drive.arm().outcome is Outcome.ACCEPTED
    drive.hold()
    drive.backend.tell(still_since_ns=drive.now_ns + 1)
    assert drive.refused()[0] == "moved"


# a real arm


def real(**changes):
    return Drive(dataclasses.replace(KNOWN, **changes), RealArm(), camera=0)


def publish(drive, calibration_id="c", plan_id="p1"):
    """A plan of a frame that is taken now, by a camera with that calibration."""
    drive.see()
    drive.publish(plan(plan_id, stamp=dataclasses.replace(drive.stamp(), calibration_id=calibration_id)))


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
    assert drive.ended == (HELD, code)


# recordings that are replayed


def test_a_real_arm_holds_when_a_recording_is_replayed_and_is_armed_again_once_that_is_over():
    drive = real()
    publish(drive)
    drive.arm(pressed=True)
    drive.run(20, pressed=True)
    drive.hear(REPLAY_CLOCK, ReplayClock(EPOCH - 3600 * SECOND, 1.0))
    assert drive.ended == (HELD, "replay")
    assert stands_still(drive)
    answer = drive.arm(pressed=True)
    assert (answer.code, "a recording is replayed" in answer.reason) == ("replay", True)
    publish(drive, plan_id="p2")
    for _ in range(210):
        drive.tick()
    drive.see()
    assert drive.arm("p2", pressed=True).code == "replay", "a plan that came meanwhile may be of the recording"
    assert drive.arm(pressed=True).code == ""


def test_each_arm_hears_its_own_heartbeat_and_a_simulated_one_lives_in_the_time_of_a_recording():
    simulated, real = (RobotBridge(RobotBridgeConfig(arm="psm2"), arm()) for arm in (UnreliableArm, RealArm))
    heard = [(entry.topic, entry.instance) for entry in simulated.inputs]
    assert heard == [(PLAN, "main"), (HEARTBEAT, "psm2"), (SURFACE, "main"), (FRAME_NOTICE, "main"), (TAIL, "main")]
    assert [entry.topic for entry in real.inputs][len(heard) :] == [REPLAY_CLOCK]
    assert (simulated.accepts_replayed_time, real.accepts_replayed_time) == (True, False)


@pytest.mark.parametrize("jump_s", [3600, -3600])
def test_an_arm_holds_where_a_replay_ends_or_begins_under_it(jump_s):
    drive = Drive().armed().run(20)
    drive.tick(jump_s * SECOND)
    assert drive.events[-1].kind is HELD
    assert drive.events[-1].reason
