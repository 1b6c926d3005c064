"""A jaw is told to close where its instrument does, and a grasp whose jaw stays open ends with a hold."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.backend import ArmState
from agents.robot_bridge.execution import ARRIVAL_S, OPENS_S
from agents.robot_bridge.jaw import ARRIVED_RAD, FOLLOWING_JAW_RAD, UNCALIBRATED, Jaw
from schemas.messages import ExecutionKind, Phase
from shared.calibration.jaw.file import JawZero
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from tests.agents.robot_bridge.drive import EPOCH, SECOND, Drive, RealArm, UnreliableArm, plan, waypoint

DAY = 86_400 * SECOND
TOOL = "LARGE_NEEDLE_DRIVER:400006"
ZERO = JawZero("psm1", TOOL, closes_rad=-0.1, told_rad=-0.12, deviation_rad=0.005, closings=5, made_ns=EPOCH)
JAW = Jaw.calibrated(ZERO)
CLOSES = (
    waypoint((30, 8, 72), 1.0, Phase.APPROACH),
    waypoint((30, 8, 75), 0.3, Phase.CAPTURE),
    waypoint((31, 8, 75), 0.3, Phase.SLIDE, 0.4),
    waypoint((31, 8, 75), 0.0, Phase.GRASP, 0.4),
    waypoint((31, 8, 68), 0.0, Phase.RETREAT, 0.4),
)
"""Told as planners do: closed at 0."""


class Instrument(UnreliableArm):
    """A jaw whose fingers touch at an angle of their own."""

    touches_rad = ZERO.closes_rad

    def state(self, now_ns: int) -> ArmState:
        told = super().state(now_ns)
        return dataclasses.replace(told, jaw_rad=max(told.jaw_rad, self.touches_rad))


def calibrated(**changes: Any) -> RobotBridgeConfig:
    return RobotBridgeConfig(jaw_zero=dataclasses.replace(ZERO, **changes), calibration_id="c", registered_ns=EPOCH)


def driven(config: RobotBridgeConfig | None = None, depth_m: float | None = 0.002) -> Drive:
    """Armed with a grasp that closes at 0."""
    drive = Drive(config or calibrated(), Instrument(jaw_rad=0.5))
    return drive.armed(plan(waypoints=CLOSES, depth_m=depth_m, stamp=drive.stamp()))


def reached(drive: Drive) -> list[Phase | None]:
    return [event.phase for event in drive.events if event.kind is ExecutionKind.PHASE_REACHED]


def until_reached(drive: Drive, phase: Phase) -> Drive:
    for _ in range(3000):
        if phase in reached(drive):
            return drive
        drive.run(1)
    raise AssertionError(drive.events)


@given(st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), st.floats(1e-3, 0.1), st.floats(-0.3, 1.3), st.floats(0, 0.2))
def test_set_points_go_with_the_plan_without_a_jump_and_press_where_it_is_closed(closes, off, deviation, at, more):
    zero = JawZero("psm1", TOOL, closes, closes + off, deviation, 5)
    jaw = Jaw.calibrated(zero)
    closed, one, other, wide = jaw.set_points(np.array((0.0, at, at + more, 1.0)))
    assert closed == pytest.approx(zero.told_rad - jaw.squeeze_rad)
    assert jaw.squeeze_rad == pytest.approx(3 * deviation + ARRIVED_RAD)
    assert wide == pytest.approx(zero.told_rad + 1.0)
    assert -1e-12 <= other - one <= 2 * more + 1e-12
    assert jaw.told_to_close(closed) and not jaw.told_to_close(wide)


@given(st.floats(-0.5, 1.3))
def test_without_a_calibration_set_points_are_the_plans_own(at):
    assert UNCALIBRATED.set_points(np.array([at])).tolist() == [at]
    assert UNCALIBRATED.unreachable((0.5, 1.0)) is None
    assert UNCALIBRATED.explained_rad(plan()) == FOLLOWING_JAW_RAD


def test_a_closed_jaw_may_stay_as_far_open_as_thread_that_deep_between_its_fingers_explains():
    shallow, deep, unknown = (JAW.explained_rad(plan(depth_m=depth)) for depth in (0.002, 0.0051, None))
    assert 0.1 < shallow < deep < FOLLOWING_JAW_RAD
    assert unknown == pytest.approx(deep, abs=1e-3)
    # a thread of 0.4 mm, as planners have it, and what follows as badly as it may
    assert 2 * np.arcsin(0.0002 / (0.0102 - 0.0051)) + ARRIVED_RAD < deep


def test_an_instrument_that_does_not_close_at_0_closes_with_its_calibration_and_is_told_open_as_it_is():
    drive = driven().run(3000)
    assert drive.ended == (ExecutionKind.FINISHED, "")
    assert reached(drive)[-2:] == [Phase.GRASP, Phase.RETREAT]
    sent = float(drive.backend._position[6])
    assert sent == pytest.approx(ZERO.told_rad - JAW.squeeze_rad)
    told = drive.states[-1]
    assert (told.jaw_zero_rad, told.jaw_rad) == (ZERO.closes_rad, pytest.approx(0.0))
    # without one it is sent to 0, and stays a tenth of a radian open
    open_at_0 = driven(RobotBridgeConfig()).run(3000)
    assert open_at_0.ended == (ExecutionKind.FINISHED, "")
    assert float(open_at_0.backend._position[6]) == 0.0
    assert (open_at_0.states[-1].jaw_zero_rad, open_at_0.states[-1].jaw_rad) == (0.0, 0.0)


@pytest.mark.parametrize(("open_rad", "depth_m"), [(0.05, 0.002), (0.12, 0.002), (0.2, 0.0051)])
def test_a_jaw_that_presses_on_thread_is_closed(open_rad, depth_m):
    drive = driven(depth_m=depth_m)
    drive.backend.touches_rad = ZERO.closes_rad + open_rad
    assert drive.run(3000).ended == (ExecutionKind.FINISHED, "")


def test_a_jaw_that_lags_is_waited_for():
    drive = until_reached(driven(), Phase.SLIDE)
    before = list[float]()

    def late(told: ArmState) -> ArmState:
        before.append(told.jaw_rad)
        # 0.4 s behind, more than any drive's lag, but never so far that it does not follow
        return dataclasses.replace(told, jaw_rad=min(before[-min(len(before), 40)], told.jaw_rad + 0.25))

    drive.backend.tells = late
    assert drive.run(3000).ended == (ExecutionKind.FINISHED, "")


@pytest.mark.parametrize("open_rad", [0.16, 0.28])
def test_a_jaw_that_stays_open_as_it_is_told_to_close_ends_the_grasp_with_a_hold(open_rad):
    drive = driven()
    drive.backend.touches_rad = ZERO.closes_rad + open_rad
    drive.run(3000)
    assert drive.ended == (ExecutionKind.HELD, "jaw_open")
    assert reached(drive)[-1] is Phase.SLIDE
    assert f"stays {open_rad:.2f} rad open" in drive.events[-1].reason
    assert "then set a goal again" in drive.events[-1].reason
    # what was held at the thread goes on only from a new frame
    assert drive.arm().code == "out_of_order"


def test_a_jaw_that_is_blocked_long_before_it_is_closed_does_not_follow():
    drive = driven()
    drive.backend.touches_rad = ZERO.closes_rad + 0.4
    assert drive.run(3000).ended == (ExecutionKind.HELD, "not_following")


def test_a_jaw_is_waited_for_for_a_second_in_which_a_hold_counts_at_once():
    drive = until_reached(driven(), Phase.SLIDE)
    drive.backend.touches_rad = ZERO.closes_rad + 0.2
    waited = 0
    while drive.bridge._execution is not None and drive.bridge._execution._waited_s < ARRIVAL_S / 2:
        drive.run(1)
        waited += 1
        assert waited < 1000
    assert drive.hold().code == ""
    assert drive.ended == (ExecutionKind.HELD, "hold_command")


def test_a_jaw_that_opens_again_as_it_retreats_ends_the_motion_and_one_that_does_for_a_moment_does_not():
    for ticks, code in ((round(OPENS_S * 100) - 2, ""), (round(OPENS_S * 100) + 2, "jaw_open")):
        drive = until_reached(driven(), Phase.GRASP)
        drive.backend.touches_rad = ZERO.closes_rad + 0.2
        drive.run(ticks)
        drive.backend.touches_rad = ZERO.closes_rad
        assert drive.run(3000).ended[1] == code


def test_without_a_calibration_too_a_jaw_that_opens_as_it_retreats_ends_the_motion():
    drive = until_reached(driven(RobotBridgeConfig()), Phase.GRASP)
    drive.backend.touches_rad = FOLLOWING_JAW_RAD + 0.01
    assert drive.run(3000).ended == (ExecutionKind.HELD, "jaw_open")


def test_a_plan_that_has_the_jaw_open_at_the_end_of_its_grasp_is_not_held_for_it():
    opens = (*CLOSES[:3], dataclasses.replace(CLOSES[3], jaw_rad=0.3), dataclasses.replace(CLOSES[4], jaw_rad=0.5))
    drive = Drive(calibrated(), Instrument(jaw_rad=0.5))
    assert drive.armed(plan(waypoints=opens)).run(3000).ended == (ExecutionKind.FINISHED, "")


@pytest.mark.parametrize("told_rad", [-0.68, 0.15])
def test_a_closing_that_the_jaw_cannot_be_told_is_refused_in_a_sentence(told_rad):
    drive = Drive(calibrated(closes_rad=told_rad, told_rad=told_rad), Instrument())
    drive.publish(plan(waypoints=(dataclasses.replace(CLOSES[0], jaw_rad=1.3), *CLOSES[1:])))
    code, reason = drive.refused()
    assert code == "jaw_limit"
    lower, upper = LARGE_NEEDLE_DRIVER.jaw_limit
    assert f"outside {lower} to {upper}" in reason


@pytest.mark.parametrize(
    ("changes", "mounted", "told"),
    [
        ({"made_ns": EPOCH - 31 * DAY}, TOOL, "calibrated 31 days ago, and 30 are allowed"),
        ({"made_ns": EPOCH + 3 * DAY}, TOOL, "calibrated 3 days ahead of now"),
        ({"made_ns": 0}, TOOL, "nobody says when the jaw was calibrated"),
        ({"instrument": "PROGRASP:400049"}, TOOL, f"with PROGRASP:400049, and {TOOL} is mounted"),
        ({"made_ns": EPOCH - 29 * DAY}, TOOL, ""),
        ({"instrument": "PROGRASP:400049"}, "", ""),
    ],
)
def test_a_real_arm_is_not_armed_by_a_calibration_of_long_ago_or_of_another_instrument(changes, mounted, told):
    for arm in (RealArm(), UnreliableArm()):
        config = dataclasses.replace(calibrated(**changes), tissue_needed=False)
        drive = Drive(config, arm, camera=0)
        arm.tell(instrument=mounted)
        drive.run(2)
        drive.publish(plan(waypoints=CLOSES[:1], stamp=drive.stamp()))
        answer, refuses = drive.arm(pressed=True), bool(told) and arm.is_real
        assert answer.code == ("unknown" if refuses else "")
        assert not refuses or told in answer.reason
        assert not refuses or "calibrate it anew with suturegrasp calibrate jaw" in answer.reason
