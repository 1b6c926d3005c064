"""The bridge as it is fed: what it carries out, who must stand by, and what ends a motion."""

import dataclasses
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from agents.robot_bridge.agent import MOST_SEGMENTS, RobotBridgeConfig, RobotBridgeError
from agents.robot_bridge.backend import ArmState, Readiness
from agents.robot_bridge.limits import MotionLimits
from agents.robot_bridge.plans import Code
from schemas.messages import ChangeState, CommandHeader, ExecutionKind, Outcome, Phase, RobotMode, StateWord, Waypoint
from schemas.topics import CHANGE_STATE, ROBOT_STATE
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER, forward
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.runtime.agent import Command
from tests.agents.robot_bridge.drive import (
    EPOCH,
    SECOND,
    TICK,
    WAYPOINTS,
    Drive,
    RealArm,
    UnreliableArm,
    moving,
    plan,
    stands_still,
    tissue_before,
)

HELD, FINISHED = ExecutionKind.HELD, ExecutionKind.FINISHED


def test_an_armed_plan_is_carried_out_phase_by_phase_to_its_end_and_each_turn_tells_where_the_arm_is() -> None:
    drive = Drive().armed(plan()).run(2000)
    reached = [(ExecutionKind.PHASE_REACHED, phase) for phase in dict.fromkeys(w.phase for w in WAYPOINTS)]
    told = [(event.kind, event.phase) for event in drive.events]
    assert told == [(ExecutionKind.ACCEPTED, None), *reached, (FINISHED, None)]
    end = drive.states[-1]
    # half a turn about the fingers is nearer from where the arm stood, and the same to a jaw
    as_planned = end.T_camera_base @ end.T_base_tool @ np.diag((-1.0, -1.0, 1.0, 1.0))
    np.testing.assert_allclose(as_planned, WAYPOINTS[-1].T_camera_tool, atol=1e-9)
    assert (end.mode, end.jaw_rad) == (RobotMode.IDLE, pytest.approx(-0.2))
    assert [state.measured_ns for state in drive.states] == list(range(EPOCH, drive.now_ns + 1, TICK))
    assert [state.plan_id for state in (drive.states[0], *drive.states[-2:])] == ["", "p1", ""]
    for state in drive.states[::20]:
        np.testing.assert_allclose(state.T_base_tool, forward(state.joints), atol=1e-15)
        np.testing.assert_array_equal(state.T_camera_base, SIMULATED_T_CAMERA_BASE)
    assert stands_still(drive)
    assert drive.arm().code == Code.CARRIED_OUT, "what was carried out is so once"


def test_irregular_ticks_make_it_late_but_never_fast() -> None:
    drive = Drive().armed()
    for step in np.random.default_rng(7).choice((2_000_000, 10_000_000, 15_000_000, 90_000_000), 3000):
        before = drive.states[-1]
        drive.beat()
        after = drive.state(int(step))
        assert (np.abs(after.joints - before.joints) <= LARGE_NEEDLE_DRIVER.max_speeds * step * 1e-9 + 1e-12).all()
        moved = np.linalg.norm(after.T_base_tool[:3, 3] - before.T_base_tool[:3, 3])
        assert moved <= MotionLimits().speed * 2 * TICK * 1e-9 * 1.001
        if not drive.bridge.executes:
            break
    assert drive.events[-1].kind is FINISHED


def test_a_motion_goes_over_to_another_ratio_smoothly_and_takes_as_much_longer() -> None:
    drives = [Drive(RobotBridgeConfig(ratio=ratio)).armed(plan(waypoints=WAYPOINTS[:2])) for ratio in (1.0, 0.5, 0.5)]
    for drive in drives:
        drive.run(40)
    drives[2].bridge.configure(RobotBridgeConfig(ratio=1.0))
    for drive in drives:
        assert drive.run(800).events[-1].kind is FINISHED
        places = np.stack([state.T_base_tool[:3, 3] for state in drive.states])
        assert np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() * 100**2 <= 1.5 * MotionLimits().acceleration
    full, half, changed = (len(drive.states) for drive in drives)
    assert half > 1.9 * full
    assert full < changed < full + 60


# who stands by


def test_nothing_moves_before_the_first_heartbeat_of_an_arming_which_lapses_without() -> None:
    drive = Drive()
    drive.publish(plan())
    drive.beat()
    drive.arm()
    for _ in range(100):
        state = drive.state()
        assert (state.mode, state.plan_id) == (RobotMode.IDLE, "p1")
        np.testing.assert_array_equal(state.joints, drive.states[0].joints)
    drive.tick()
    assert drive.ended == (HELD, Code.HEARTBEAT_LOST)
    assert stands_still(drive)


@pytest.mark.parametrize(
    "wrong",
    [
        {"plan_id": "p2"},
        {"arm": "psm2"},
        {"arming_id": "arming-0"},
        {"at_ns": EPOCH - 3600 * SECOND},
        {"echo_ns": 1},
        {"echo_ns": EPOCH + 1},
    ],
)
def test_heartbeats_of_others_of_long_ago_or_of_challenges_that_never_were_keep_nothing_moving(wrong: Any) -> None:
    drive = moving()
    for _ in range(25):
        drive.beat(**wrong)
        drive.tick()
    assert drive.ended == (HELD, Code.HEARTBEAT_LOST)


@pytest.mark.parametrize("off_s", [10, -10])
def test_it_does_not_matter_what_an_operators_clock_says(off_s: int) -> None:
    drive = moving()
    for _ in range(60):
        drive.beat(at_ns=drive.now_ns + off_s * SECOND, echo_ns=drive.states[-1].challenge_ns)
        drive.tick()
    assert drive.states[-1].mode is RobotMode.MOVING


def test_an_answer_is_as_young_as_the_challenge_that_it_echoes() -> None:
    drive = moving()
    last_ns = drive.states[-1].challenge_ns
    while drive.bridge.executes:
        drive.beat(echo_ns=last_ns)
        drive.tick()
    assert drive.ended == (HELD, "heartbeat_lost")
    assert 0.2 * SECOND < drive.now_ns - last_ns <= 0.2 * SECOND + TICK
    assert drive.states[-1].mode is RobotMode.HOLDING
    assert stands_still(drive)


def test_a_simulated_arm_is_kept_moving_by_heartbeats_of_older_recordings_each_of_which_counts_once() -> None:
    drive = moving()
    for _ in range(60):
        drive.beat(at_ns=drive.now_ns)
        drive.tick()
    assert drive.bridge.executes
    last_ns = drive.now_ns
    while drive.bridge.executes:
        drive.beat(at_ns=last_ns)
        drive.tick()
    assert 0.2 * SECOND < drive.now_ns - last_ns <= 0.2 * SECOND + TICK


def test_answers_that_take_too_long_are_named_with_how_long_they_take() -> None:
    drive = moving()
    while drive.bridge.executes:
        drive.tick()
        drive.beat(echo_ns=drive.states[-31].challenge_ns)
    assert drive.ended == (HELD, "round_trip")
    assert "take 300 ms from the bridge to whoever stands by and back" in drive.events[-1].reason


@pytest.mark.parametrize(
    ("elapsed_ns", "code", "named"),
    [
        (SECOND // 4, "heartbeat_lost", "0.2 s passed between two turns"),
        (10 * SECOND, "heartbeat_lost", "its clock was set, or it stood still"),
        (-1, "clock", "went backwards"),
    ],
)
def test_a_bridge_that_stalled_or_whose_clock_was_set_holds_and_says_so(elapsed_ns: int, code: str, named: str) -> None:
    drive = moving()
    drive.beat()
    drive.tick(elapsed_ns)
    assert drive.ended == (HELD, code)
    assert named in drive.events[-1].reason
    assert stands_still(drive)


def test_a_hold_stops_at_once_and_the_plan_goes_on_to_its_end_only_when_armed_again() -> None:
    drive = moving()
    before = drive.states[-1]
    assert drive.hold("psm2").code == Code.OTHER_ARM
    assert drive.bridge.executes
    assert drive.hold().outcome is Outcome.ACCEPTED
    assert drive.ended == (HELD, "hold_command")
    after = drive.state()
    np.testing.assert_array_equal(after.joints, before.joints)
    assert (after.mode, after.plan_id, stands_still(drive)) == (RobotMode.HOLDING, "", True)
    drive.arm()
    assert [event.arming_id for event in drive.events] == ["arming-1", "arming-1", "arming-2"]
    assert drive.run(2000).events[-1].kind is FINISHED


def test_what_was_held_at_the_thread_goes_on_only_from_a_frame_of_since() -> None:
    drive = moving()
    while not any(event.phase is Phase.APPROACH for event in drive.events):
        drive.run(5)
    drive.hold()
    code, reason = drive.refused()
    assert (code, "which may have moved the thread: plan again" in reason) == ("out_of_order", True)
    drive.publish(plan("p2", captured_ns=drive.now_ns))
    assert drive.arm("p2").outcome is Outcome.ACCEPTED


@pytest.mark.parametrize("backend", [UnreliableArm, RealArm])
def test_after_a_clock_was_set_back_no_plan_tissue_or_frame_of_before_counts(backend: Any) -> None:
    drive = Drive(backend=backend(), config=RobotBridgeConfig(calibration_id="c", registered_ns=EPOCH), camera=0)
    tissue_before(drive, 0.1)
    drive.publish(plan(stamp=drive.stamp()))
    drive.tick(-60 * SECOND)
    drive.now_ns += 55 * SECOND
    drive.tick()
    assert drive.arm().code == "unknown_plan"
    drive.publish(plan("p2", stamp=drive.stamp()))
    assert drive.arm("p2", pressed=True).code == ("" if backend is UnreliableArm else "frame_age")


def test_a_real_arms_bridge_that_begins_takes_no_plan_of_a_frame_of_before() -> None:
    drive = Drive(RobotBridgeConfig(calibration_id="c", registered_ns=EPOCH, tissue_needed=False), RealArm(), camera=0)
    drive.tick()
    drive.see()
    drive.publish(plan("old", captured_ns=EPOCH - SECOND))
    code, reason = drive.refused(plan_id="old")
    assert (code, "captured before this bridge began" in reason) == ("out_of_order", True)
    drive.publish(plan("new", stamp=drive.stamp()))
    assert drive.arm("new", pressed=True).outcome is Outcome.ACCEPTED


def test_a_hold_is_answered_though_a_console_that_does_something_by_itself_cannot_be_told_to_pause() -> None:
    drive, asked = Drive(backend=RealArm()), list[StateWord]()

    def fails(word: StateWord, _now_ns: int) -> str:
        asked.append(word)
        raise OSError("the link is gone")

    drive.backend.change_state = fails
    drive.backend.tell(busy=True)
    drive.tick()
    assert drive.hold().outcome is Outcome.ACCEPTED
    drive.tick()
    assert asked == [StateWord.PAUSE] * 2, "and again in each turn"
    drive.backend.tell(busy=False)
    drive.tick()
    drive.tick()
    assert len(asked) <= 3


def test_whoever_arms_may_ask_for_few_segments_and_gets_no_more_than_there_may_be() -> None:
    drive = Drive().armed(segments=2**32 - 1)
    assert drive.bridge._execution is not None
    assert drive.bridge._execution.segments == MOST_SEGMENTS


def test_an_arm_at_rest_that_is_held_says_so_and_a_bridge_that_is_closed_lets_its_arm_rest() -> None:
    drive = Drive()
    assert drive.hold().outcome is Outcome.ACCEPTED
    assert (drive.state().mode, [event.kind for event in drive.events]) == (RobotMode.HOLDING, [ExecutionKind.HELD])
    drive = moving()
    drive.bridge.close()
    assert stands_still(drive)


def test_an_arm_that_is_armed_or_simulated_or_another_one_changes_no_state() -> None:
    def change(drive: Drive, arm: str = "psm1") -> str:
        message = ChangeState(CommandHeader("c", drive.now_ns + SECOND, "ann"), arm, StateWord.HOME)
        return drive.feed(Command(CHANGE_STATE, "psm1", message, drive.now_ns))[0].code

    assert (change(moving()), change(Drive()), change(Drive(), "psm2")) == (Code.BUSY, Code.NO_STATES, Code.OTHER_ARM)


# what the arm tells


@pytest.mark.parametrize(
    ("readiness", "mode"), [(Readiness.DISABLED, RobotMode.DISABLED), (Readiness.FAULT, RobotMode.FAULT)]
)
def test_an_arm_that_is_not_ready_is_neither_armed_nor_moved(readiness: Readiness, mode: RobotMode) -> None:
    drive = moving()
    drive.backend.tell(readiness=readiness, reason="the clutch is pressed")
    assert drive.state().mode is mode
    assert drive.ended == (HELD, "not_ready")
    code, reason = drive.refused()
    assert (code, "the clutch is pressed" in reason) == ("not_ready", True)
    drive.backend.tell()
    assert (drive.state().mode, stands_still(drive)) == (RobotMode.HOLDING, True)
    # between two turns of an arm at rest much may happen
    drive.backend.tell(readiness=readiness)
    drive.now_ns += SECOND // 20
    assert drive.arm().code == "not_ready"


def test_an_arm_that_reports_no_numbers_is_held_and_one_that_never_did_has_no_state() -> None:
    drive = moving()
    drive.backend.tell(joints=np.full(6, np.nan))
    assert drive.state().mode is RobotMode.FAULT
    assert drive.ended == (HELD, "not_ready")
    assert all(np.isfinite(state.joints).all() for state in drive.states)
    assert drive.refused()[0] == "not_ready"
    arm = UnreliableArm()
    arm.tell(joints=np.full(6, np.nan))
    never = Drive(backend=arm, ticked=False)
    never.publish(plan())
    assert never.arm().code == "not_ready"
    never.tick()
    assert (never.states, never.arm().code) == ([], "not_ready")


def moved_by(joints: tuple[float, ...] = (0, 0, 0, 0, 0, 0), jaw_rad: float = 0.0) -> Callable[[ArmState], ArmState]:
    """Makes an arm tell that it is so far from where it is."""
    return lambda told: dataclasses.replace(told, joints=told.joints + np.array(joints), jaw_rad=told.jaw_rad + jaw_rad)


@pytest.mark.parametrize(
    ("tells", "code"),
    [
        (moved_by((0, 0, 0.006, 0, 0, 0)), "not_following"),
        (moved_by((0, 0, 0.004, 0, 0, 0)), ""),
        (moved_by((0, 0, 0, 0, 0, 0.25)), "not_following"),
        (lambda told: dataclasses.replace(told, measured_ns=told.measured_ns - SECOND // 5), "stale_state"),
    ],
)
def test_an_arm_that_is_pushed_away_or_was_measured_too_long_ago_is_held(tells: Any, code: str) -> None:
    drive = moving()
    drive.backend.tells = tells
    drive.beat()
    drive.tick()
    assert drive.ended[1] == code


def test_an_arm_that_is_blocked_short_of_a_stop_is_held_after_a_second() -> None:
    drive = Drive().armed()
    drive.backend.tells = moved_by((0, 0, -0.001, 0, 0, 0))
    assert drive.run(2000).ended == (HELD, "not_following")


def test_an_arm_whose_jaw_does_not_follow_is_held_and_one_whose_jaw_lags_is_not() -> None:
    drive = moving()
    for behind_rad, held in ((0.25, False), (0.35, True)):
        drive.backend.tells = moved_by(jaw_rad=-behind_rad)
        drive.beat()
        drive.tick()
        assert (drive.events[-1].code == "not_following") is held
    # one that presses on what it holds follows well enough
    drive = moving()
    drive.backend.tells = lambda told: dataclasses.replace(told, jaw_rad=max(told.jaw_rad, 0.15))
    assert drive.run(3000).events[-1].kind is FINISHED


@pytest.mark.parametrize(
    ("tells", "for_ticks"),
    [
        (lambda told: dataclasses.replace(told, busy=True), 40),
        (lambda told: dataclasses.replace(told, measured_ns=told.measured_ns - 9 * TICK), 9),
    ],
)
def test_a_phase_ends_once_the_arm_is_not_busy_and_was_measured_after_the_last_set_point(tells: Any, for_ticks: int):
    drive = Drive()
    here = SIMULATED_T_CAMERA_BASE @ forward(drive.states[-1].joints)
    drive.armed(plan(waypoints=(Waypoint(here, 0.0, Phase.APPROACH, None),)))
    drive.backend.tells = tells
    assert drive.run(for_ticks).events[-1].kind is ExecutionKind.ACCEPTED
    drive.backend.tell()
    assert drive.run(40).events[-1].kind is FINISHED


# how often, and with what


def test_an_arm_has_all_turns_as_soon_as_it_is_armed_or_moved_by_others_and_few_once_it_rests() -> None:
    drive = Drive()
    assert drive.bridge.tick_hz == 100
    drive.tick(2 * SECOND)
    assert drive.bridge.tick_hz == ROBOT_STATE.resting_hz
    drive.now_ns += SECOND // 20
    drive.armed(plan(captured_ns=drive.now_ns, waypoints=WAYPOINTS[:1]))
    assert drive.bridge.tick_hz == 100
    assert drive.run(2000).events[-1].kind is FINISHED
    drive.tick()
    drive.tick(2 * SECOND)
    assert drive.bridge.tick_hz == ROBOT_STATE.resting_hz
    drive.backend.tells = moved_by((1e-2, 0, 0, 0, 0, 0))
    drive.tick(SECOND // 10)
    assert drive.bridge.tick_hz == 100


def test_a_time_that_makes_no_sense_a_ratio_above_one_and_a_base_that_is_no_pose_are_refused_by_name() -> None:
    wrong: list[tuple[str, Any]] = [("ratio", 1.1), ("T_camera_base", np.diag((1.0, 1, 2, 1)))]
    times = ("dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "tick_hz", "resting_hz")
    wrong += [(name, value) for name in times for value in (0.0, -1.0, np.nan, np.inf)]
    for name, value in wrong:
        with pytest.raises(RobotBridgeError, match=name):
            dataclasses.replace(RobotBridgeConfig(), **{name: value})


def test_the_documentation_explains_every_code() -> None:
    text = (pathlib.Path(__file__).parents[3] / "docs/robot_bridge.md").read_text()
    assert [code for code in Code if f"`{code.value}`" not in text] == []
