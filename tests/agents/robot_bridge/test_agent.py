"""The bridge as it is fed: what it carries out, what ends a motion, and what it refuses to begin."""

import dataclasses
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig, RobotBridgeError
from agents.robot_bridge.backend import ArmState, Readiness
from agents.robot_bridge.limits import MotionLimits
from agents.robot_bridge.refusals import Code
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.codec import encode
from schemas.messages import (
    ChangeState,
    CommandHeader,
    ExecutionKind,
    FrameStamp,
    GraspPlan,
    Outcome,
    Phase,
    RobotMode,
    StateWord,
    Waypoint,
)
from schemas.topics import CHANGE_STATE, FRAME_NOTICE, HEARTBEAT, PLAN, ROBOT_STATE, SURFACE
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER, forward
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.runtime.agent import Command, Output
from tests.agents.robot_bridge.drive import (
    EPOCH,
    SECOND,
    TICK,
    WAYPOINTS,
    Drive,
    UnreliableArm,
    moving,
    plan,
    rejected,
    stands_still,
    tissue_before,
    waypoint,
)

HELD, FINISHED = ExecutionKind.HELD, ExecutionKind.FINISHED


@pytest.fixture(scope="module")
def finished() -> Drive:
    """Plan p1 from its arming to its end; to be read only."""
    drive = Drive().armed(plan())
    drive.run(2000)
    return drive


def test_an_armed_plan_is_carried_out_phase_by_phase_to_its_end(finished: Drive) -> None:
    reached = [(ExecutionKind.PHASE_REACHED, phase) for phase in Phase]
    told = [(event.kind, event.phase) for event in finished.events]
    assert told == [(ExecutionKind.ACCEPTED, None), *reached, (FINISHED, None)]
    end = finished.states[-1]
    assert (end.mode, end.plan_id) == (RobotMode.IDLE, "")
    # half a turn about the fingers is nearer from where the arm stood, and the same to a jaw
    as_planned = end.T_camera_base @ end.T_base_tool @ np.diag((-1.0, -1.0, 1.0, 1.0))
    np.testing.assert_allclose(as_planned, WAYPOINTS[-1].T_camera_tool, atol=1e-9)
    assert end.jaw_rad == pytest.approx(-0.2)


def test_each_turn_tells_a_state_that_agrees_with_the_kinematics(finished: Drive) -> None:
    assert [state.measured_ns for state in finished.states] == list(range(EPOCH, finished.now_ns + 1, TICK))
    for state in finished.states[::20]:
        np.testing.assert_allclose(state.T_base_tool, forward(state.joints), atol=1e-15)
        np.testing.assert_array_equal(state.T_camera_base, SIMULATED_T_CAMERA_BASE)
    assert [state.plan_id for state in (finished.states[0], *finished.states[-2:])] == ["", "p1", ""]


def test_speed_limits_hold_between_any_two_states(finished: Drive) -> None:
    limits = MotionLimits()
    joints = np.stack([state.joints for state in finished.states])
    places = np.stack([state.T_base_tool[:3, 3] for state in finished.states])
    jaw = np.array([state.jaw_rad for state in finished.states])
    assert (np.abs(np.diff(joints, axis=0)) * 100 <= LARGE_NEEDLE_DRIVER.max_speeds).all()
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() * 100 <= limits.speed * 1.001
    assert np.abs(np.diff(jaw)).max() * 100 <= limits.jaw_speed * 1.001
    acceleration = np.linalg.norm(np.diff(places, 2, axis=0), axis=1) * 100**2
    assert acceleration.max() <= limits.acceleration * 1.01


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
    approach = plan(waypoints=WAYPOINTS[:2])
    drives = [Drive(RobotBridgeConfig(ratio=ratio)).armed(approach) for ratio in (1.0, 0.5, 0.5)]
    for drive in drives:
        drive.run(40)
    drives[2].bridge.configure(RobotBridgeConfig(ratio=1.0))
    for drive in drives:
        drive.run(800)
        assert drive.events[-1].kind is FINISHED
        places = np.stack([state.T_base_tool[:3, 3] for state in drive.states])
        assert np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() * 100**2 <= 1.5 * MotionLimits().acceleration
    full, half, changed = (len(drive.states) for drive in drives)
    assert half > 1.9 * full
    assert full < changed < full + 60


# heartbeats


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


def test_a_heartbeat_of_an_earlier_arming_feeds_no_later_one_of_the_same_plan() -> None:
    drive = moving()
    earlier = drive.arming_id
    drive.hold()
    drive.arm()
    joints = drive.state().joints
    for _ in range(50):
        drive.beat(arming_id=earlier)
        assert np.array_equal(drive.state().joints, joints)
    drive.beat()
    assert drive.state().mode is RobotMode.MOVING
    told = [(event.kind, event.arming_id) for event in drive.events]
    accepted = ExecutionKind.ACCEPTED
    assert told == [(accepted, "arming-1"), (HELD, "arming-1"), (accepted, "arming-2")]


def test_a_lost_heartbeat_holds_within_a_fifth_of_a_second_and_a_tick() -> None:
    drive = moving()
    drive.beat()
    last_ns = drive.now_ns
    while drive.bridge.executes:
        drive.tick()
    assert drive.ended == (HELD, "heartbeat_lost")
    assert 0.2 * SECOND < drive.now_ns - last_ns <= 0.2 * SECOND + TICK
    assert stands_still(drive)
    assert drive.states[-1].mode is RobotMode.HOLDING


@pytest.mark.parametrize(
    "wrong",
    [
        {"plan_id": "p2"},
        {"arm": "psm2"},
        {"at_ns": EPOCH - 3600 * SECOND},
        {"echo_ns": 1},
        {"echo_ns": EPOCH + 1},
        {"echo_ns": EPOCH + 3600 * SECOND},
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
    assert drive.events[-1].kind is HELD
    assert drive.now_ns - last_ns <= 0.2 * SECOND + TICK
    assert stands_still(drive)


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
        (SECOND // 4, "heartbeat_lost", ""),
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


# holds


def test_a_hold_of_an_arm_at_rest_shows_in_its_mode() -> None:
    drive = Drive()
    assert drive.hold().outcome is Outcome.ACCEPTED
    assert (drive.state().mode, drive.events) == (RobotMode.HOLDING, [])


def test_a_hold_stops_at_once_and_the_plan_goes_on_to_its_end_only_when_armed_again() -> None:
    drive = moving()
    before = drive.states[-1]
    assert drive.hold("psm2").code == Code.OTHER_ARM
    assert drive.bridge.executes
    assert drive.hold().outcome is Outcome.ACCEPTED
    assert drive.ended == (HELD, "hold_command")
    after = drive.state()
    np.testing.assert_array_equal(after.joints, before.joints)
    assert (after.mode, after.plan_id) == (RobotMode.HOLDING, "")
    assert stands_still(drive)
    drive.arm()
    drive.run(2000)
    assert drive.events[-1].kind is FINISHED
    assert stands_still(drive)
    assert drive.arm().code == Code.UNKNOWN_PLAN, "what was carried out is so once"


def test_a_bridge_that_is_closed_lets_the_arm_rest() -> None:
    drive = moving()
    drive.bridge.close()
    assert stands_still(drive)


def test_an_arm_that_is_armed_or_simulated_or_another_one_changes_no_state() -> None:
    def change(drive: Drive, arm: str = "psm1") -> str:
        message = ChangeState(CommandHeader("c", drive.now_ns + SECOND, "ann"), arm, StateWord.HOME)
        return drive.feed(Command(CHANGE_STATE, "psm1", message, drive.now_ns))[0].code

    assert (change(moving()), change(Drive()), change(Drive(), "psm2")) == (Code.BUSY, Code.NO_STATES, Code.OTHER_ARM)


# what is refused


def refused(drive: Drive, **command: str) -> tuple[str, str]:
    """The code and the reason of a refused arming, after which nothing moves."""
    answer = drive.arm(**command)
    assert answer.outcome is Outcome.REFUSED
    assert stands_still(drive, 3)
    return answer.code, answer.reason


def test_the_last_few_plans_are_known_however_many_come_for_others_or_are_rejected() -> None:
    drive = Drive()
    assert refused(drive)[0] == "unknown_plan"
    drive.publish(plan(), *(plan(f"q{i}", arm="psm2") for i in range(30)), *(rejected(f"r{i}") for i in range(30)))
    assert drive.arm().outcome is Outcome.ACCEPTED
    drive.hold()
    drive.publish(*(plan(f"p{index}") for index in range(2, 10)))
    code, reason = refused(drive)
    assert (code, "p1" in reason) == ("unknown_plan", True)
    assert drive.arm("p2").outcome is Outcome.ACCEPTED


def test_the_latest_plan_of_an_id_counts_and_one_for_another_arm_for_nothing() -> None:
    drive = Drive()
    drive.publish(plan(), rejected(), plan("p2", arm="psm2"), plan("p3"))
    code, reason = refused(drive)
    assert (code, "the goal is not on the thread" in reason) == ("rejected_plan", True)
    drive.publish(plan())
    for command in ({"plan_id": "p2"}, {"plan_id": "p3", "arm": "psm2"}, {"plan_id": "p3", "instance": "psm2"}):
        assert refused(drive, **command)[0] == "other_arm"
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
    code, reason = refused(drive, plan_id="p2")
    assert (code, "before the motion of plan p1 began" in reason) == ("out_of_order", True)
    assert drive.arm().outcome is Outcome.ACCEPTED, "what was held goes on"
    drive.hold()
    assert drive.arm("p3").outcome is Outcome.ACCEPTED


def test_what_was_held_at_the_thread_goes_on_only_from_a_frame_of_since() -> None:
    drive = moving()
    while not any(event.phase is Phase.APPROACH for event in drive.events):
        drive.run(5)
    drive.hold()
    code, reason = refused(drive)
    assert (code, "which may have moved the thread: plan again" in reason) == ("out_of_order", True)
    drive.publish(plan("p2", captured_ns=drive.now_ns))
    assert drive.arm("p2").outcome is Outcome.ACCEPTED


def test_tissue_that_was_measured_before_something_was_moved_by_hand_speaks_for_and_against_nothing() -> None:
    drive = Drive()
    tissue_before(drive, 0.05)
    drive.publish(plan(captured_ns=drive.now_ns + TICK))
    assert refused(drive)[0] == "tissue"
    drive.backend.tell(still_since_ns=drive.now_ns)
    drive.publish(plan(captured_ns=drive.now_ns))
    assert drive.arm().outcome is Outcome.ACCEPTED
    drive.hold()
    drive.backend.tell(still_since_ns=drive.now_ns + 1)
    assert refused(drive)[0] == "moved"


@pytest.mark.parametrize(("registered", "measured"), [("other", ""), ("c", "other")])
def test_a_plan_in_another_cameras_frame_than_base_or_tissue_is_refused(registered: str, measured: str) -> None:
    drive = Drive(RobotBridgeConfig(calibration_id=registered))
    if measured:
        tissue_before(drive, 0.1, measured)
    drive.publish(plan(), plan("p2", stamp=FrameStamp(1, EPOCH, EPOCH, registered)))
    code, reason = refused(drive)
    what = "tissue was measured" if measured else "arm was registered"
    assert (code, f"calibration c, and the {what} in that of other" in reason) == ("wrong_frame", True)
    assert drive.arm("p2").code == ("wrong_frame" if measured else "")


def test_a_plan_that_the_arm_cannot_follow_is_refused_before_it_moves() -> None:
    drive = Drive()
    drive.publish(plan(waypoints=(waypoint((1e306, 1e306, -1e306), 0, Phase.APPROACH),)))
    assert refused(drive)[0] == "workspace"


# what the arm tells


@pytest.mark.parametrize(
    ("readiness", "mode"), [(Readiness.DISABLED, RobotMode.DISABLED), (Readiness.FAULT, RobotMode.FAULT)]
)
def test_an_arm_that_is_not_ready_is_neither_armed_nor_moved(readiness: Readiness, mode: RobotMode) -> None:
    drive = moving()
    drive.backend.tell(readiness=readiness, reason="the clutch is pressed")
    assert drive.state().mode is mode
    assert drive.ended == (HELD, "not_ready")
    code, reason = refused(drive)
    assert (code, "the clutch is pressed" in reason) == ("not_ready", True)
    drive.backend.tell()
    assert drive.state().mode is RobotMode.HOLDING
    assert stands_still(drive)


def test_an_arm_that_reports_no_numbers_is_held_and_one_that_never_did_has_no_state() -> None:
    drive = moving()
    drive.backend.tell(joints=np.full(6, np.nan))
    assert drive.state().mode is RobotMode.FAULT
    assert drive.ended == (HELD, "not_ready")
    assert all(np.isfinite(state.joints).all() for state in drive.states)
    assert refused(drive)[0] == "not_ready"
    arm = UnreliableArm()
    arm.tell(joints=np.full(6, np.nan))
    never = Drive(backend=arm, ticked=False)
    never.publish(plan())
    assert never.arm().code == "not_ready"
    assert never.tick() is None
    assert never.arm().code == "not_ready"


def moved_by(joints: tuple[float, ...] = (0, 0, 0, 0, 0, 0), jaw_rad: float = 0.0) -> Callable[[ArmState], ArmState]:
    """Makes an arm tell that it is so far from where it is."""
    return lambda told: dataclasses.replace(told, joints=told.joints + np.array(joints), jaw_rad=told.jaw_rad + jaw_rad)


def test_an_arm_that_is_pushed_away_or_was_measured_too_long_ago_is_held() -> None:
    for tells, code in (
        (moved_by((0, 0, 0.006, 0, 0, 0)), "not_following"),
        (moved_by((0, 0, 0, 0, 0, 0.25)), "not_following"),
        (lambda told: dataclasses.replace(told, measured_ns=told.measured_ns - SECOND // 5), "stale_state"),
    ):
        drive = moving()
        drive.backend.tells = tells
        drive.beat()
        drive.tick()
        assert drive.ended == (HELD, code)


def test_an_arm_whose_jaw_does_not_follow_is_held_and_one_whose_jaw_lags_is_not() -> None:
    drive = moving()
    for behind_rad, held in ((0.25, False), (0.35, True)):
        drive.backend.tells = moved_by(jaw_rad=-behind_rad)
        drive.beat()
        drive.tick()
        assert (drive.events[-1].code == "not_following") is held


def test_a_jaw_that_presses_on_what_it_holds_follows_well_enough() -> None:
    drive = moving()
    drive.backend.tells = lambda told: dataclasses.replace(told, jaw_rad=max(told.jaw_rad, 0.15))
    drive.run(3000)
    assert drive.events[-1].kind is FINISHED


def test_an_arm_that_is_blocked_short_of_a_stop_is_held_after_a_second() -> None:
    drive = Drive().armed()
    drive.backend.tells = moved_by((0, 0, -0.001, 0, 0, 0))
    drive.run(2000)
    assert drive.ended == (HELD, "not_following")


def test_a_phase_ends_once_the_arm_is_not_busy_and_was_measured_after_the_last_set_point() -> None:
    def arrives(drive: Drive, ticks: int) -> bool:
        drive.run(ticks)
        return any(event.kind is ExecutionKind.PHASE_REACHED for event in drive.events)

    for tells, for_ticks in (
        (lambda told: dataclasses.replace(told, busy=True), 40),
        (lambda told: dataclasses.replace(told, measured_ns=told.measured_ns - 9 * TICK), 9),
    ):
        drive = Drive()
        here = SIMULATED_T_CAMERA_BASE @ forward(drive.states[-1].joints)
        drive.armed(plan(waypoints=(Waypoint(here, 0.0, Phase.APPROACH, None),)))
        drive.backend.tells = tells
        assert not arrives(drive, for_ticks)
        drive.backend.tell()
        assert arrives(drive, 40)


# how often, and with what


def test_an_arm_has_all_turns_as_soon_as_it_is_armed_or_moved_by_others_and_few_once_it_rests() -> None:
    drive = Drive()
    assert drive.bridge.tick_hz == 100
    drive.tick(2 * SECOND)
    assert drive.bridge.tick_hz == ROBOT_STATE.resting_hz
    drive.now_ns += SECOND // 20
    drive.armed(plan(captured_ns=drive.now_ns, waypoints=WAYPOINTS[:1]))
    assert drive.bridge.tick_hz == 100
    drive.run(2000)
    assert drive.events[-1].kind is FINISHED
    drive.tick()
    drive.tick(2 * SECOND)
    assert drive.bridge.tick_hz == ROBOT_STATE.resting_hz
    drive.backend.tells = moved_by((1e-2, 0, 0, 0, 0, 0))
    drive.tick(SECOND // 10)
    assert drive.bridge.tick_hz == 100


def test_an_arm_that_broke_since_its_last_turn_is_not_armed() -> None:
    drive = Drive()
    drive.publish(plan())
    drive.now_ns += SECOND // 20
    drive.backend.tell(readiness=Readiness.DISABLED)
    assert drive.arm().code == "not_ready"


def test_the_bridge_is_named_after_its_arm_and_listens_to_that_arms_heartbeat() -> None:
    bridge = RobotBridge(RobotBridgeConfig(arm="psm2"), SimulatedPsm())
    assert (bridge.kind, bridge.instance) == ("robot_bridge", "psm2")
    heard = [(entry.topic, entry.instance) for entry in bridge.inputs]
    assert heard == [(PLAN, "main"), (HEARTBEAT, "psm2"), (SURFACE, "main"), (FRAME_NOTICE, "main")]


@pytest.mark.parametrize("name", ["dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "tick_hz", "resting_hz"])
def test_a_time_that_makes_no_sense_a_ratio_above_one_and_a_base_that_is_no_pose_are_refused_by_name(name: str) -> None:
    for value in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(RobotBridgeError, match=name):
            dataclasses.replace(RobotBridgeConfig(), **{name: value})
    with pytest.raises(RobotBridgeError, match="ratio must not be above 1"):
        RobotBridgeConfig(ratio=1.1)
    with pytest.raises(RobotBridgeError, match="T_camera_base"):
        RobotBridgeConfig(T_camera_base=np.diag((1.0, 1, 2, 1)))


def test_the_documentation_explains_every_code() -> None:
    text = (pathlib.Path(__file__).parents[3] / "docs/robot_bridge.md").read_text()
    assert [code for code in Code if f"`{code.value}`" not in text] == []


PLANS = (
    plan(),
    plan("p2", waypoints=WAYPOINTS[:1]),
    rejected("p2"),
    plan("p3", arm="psm2"),
    plan("p4", captured_ns=0),
    plan("p5", waypoints=(waypoint((0, 0, -1e300), 1e300, Phase.GRASP),)),
)
plan_ids = st.sampled_from(["p1", "p1", "p1", "p2", "p3", "p4", "p5", "never"])
arms = st.sampled_from(["psm1", "psm1", "psm1", "psm2"])
actions = st.one_of(
    st.tuples(st.just("tick"), st.sampled_from([TICK, TICK, 0, 3 * TICK, SECOND // 2, -TICK]), st.integers(1, 30)),
    st.tuples(st.just("go"), st.integers(1, 60)),
    st.tuples(st.just("publish"), st.sampled_from(PLANS)),
    st.tuples(st.just("arm"), plan_ids, arms),
    st.tuples(st.just("beat"), plan_ids, arms, st.integers(-(2**63), 2**63 - 1)),
    st.tuples(st.just("hold"), arms),
    st.tuples(st.just("becomes"), st.sampled_from(Readiness)),
)


class Watch:
    """An account of its own of when the arm may move: armed, and beaten within 0.2 s, at the tick before."""

    def __init__(self) -> None:
        self.drive, self.armed, self.allowed = Drive(), "", False
        self.beat_ns, self.newest_ns = 0, 0
        self.drive.publish(plan())

    def tick(self, elapsed_ns: int, times: int) -> None:
        for _ in range(times):
            before, events = self.drive.states[-1], len(self.drive.events)
            after = self.drive.state(elapsed_ns)
            same = np.array_equal(before.joints, after.joints) and before.jaw_rad == after.jaw_rad
            assert same or self.allowed
            if {event.kind for event in self.drive.events[events:]} & {HELD, FINISHED}:
                self.armed = ""
            self.allowed = bool(self.armed) and self.drive.now_ns - self.beat_ns <= 0.2 * SECOND

    def go(self, times: int) -> None:
        for _ in range(times):
            self.beat(self.armed or "p1", "psm1", self.drive.now_ns)
            self.tick(TICK, 1)

    def arm(self, plan_id: str, arm: str) -> None:
        if self.drive.arm(plan_id, arm).outcome is Outcome.ACCEPTED:
            assert not self.armed
            self.armed, self.beat_ns, self.newest_ns = plan_id, 0, 0

    def beat(self, plan_id: str, arm: str, at_ns: int) -> None:
        self.drive.beat(plan_id, arm, at_ns)
        if (plan_id, arm) == (self.armed, "psm1") and at_ns > self.newest_ns:
            self.beat_ns, self.newest_ns = self.drive.now_ns, at_ns

    def hold(self, arm: str) -> None:
        if self.drive.hold(arm).outcome is Outcome.ACCEPTED:
            self.armed, self.allowed = "", False

    def publish(self, message: GraspPlan) -> None:
        self.drive.publish(message)

    def becomes(self, readiness: Readiness) -> None:
        self.drive.backend.tell(readiness=readiness)


@settings(max_examples=25)
@given(st.booleans(), st.lists(actions, max_size=40))
def test_whatever_arrives_it_answers_and_moves_only_while_armed_with_a_live_heartbeat(
    under_way: bool, sequence: list[tuple[Any, ...]]
) -> None:
    watch = Watch()
    if under_way:
        watch.arm("p1", "psm1")
        watch.go(50)
        assert watch.drive.states[-1].mode is RobotMode.MOVING
    for what, *arguments in sequence:
        getattr(watch, what)(*arguments)
    for said in watch.drive.said:
        encode(said.message if isinstance(said, Output) else said)
