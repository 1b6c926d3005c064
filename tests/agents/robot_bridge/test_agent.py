import dataclasses
import pathlib
from collections.abc import Callable, Sequence
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
    Arm,
    ChangeState,
    CommandAnswer,
    CommandHeader,
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    Hold,
    Outcome,
    Phase,
    Policy,
    RectifiedStereo,
    RobotMode,
    RobotState,
    StateWord,
    Status,
    TissueSurface,
    Waypoint,
)
from schemas.topics import ARM, CHANGE_STATE, EXECUTION, FRAME_NOTICE, HEARTBEAT, HOLD, PLAN, ROBOT_STATE, SURFACE
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER, forward
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import exp_so3, transform
from shared.runtime.agent import Command, Output, Received, Tick

SECOND, TICK = 10**9, 10**7
EPOCH = 1_700_000_000 * SECOND


def waypoint(place_mm: Sequence[float], jaw_rad: float, phase: Phase, roll: float = 0.3) -> Waypoint:
    T = transform(exp_so3(np.array((0.1, 0, roll))), np.array(place_mm, float) / 1e3)
    return Waypoint(T, jaw_rad, phase, None)


WAYPOINTS = (
    waypoint((15, 5, 60), 1.0, Phase.APPROACH),
    waypoint((15, 5, 75), 1.0, Phase.APPROACH),
    waypoint((15, 5, 75), 0.3, Phase.CAPTURE),
    waypoint((18, 5.5, 75), 0.3, Phase.SLIDE, 0.4),
    waypoint((20, 6, 75), 0.3, Phase.SLIDE, 0.5),
    waypoint((20, 6, 75), -0.2, Phase.GRASP, 0.5),
    waypoint((20, 6, 65), -0.2, Phase.RETREAT, 0.5),
)


def plan(plan_id: str = "p1", arm: str = "psm1", captured_ns: int = EPOCH, **changes: Any) -> GraspPlan:
    values: dict[str, Any] = {
        "status": Status.OK,
        "reason": "",
        "waypoints": WAYPOINTS,
        "policy": Policy.CAPTURE_SLIDE_GRASP,
        "s_goal": 0.5,
        "s_capture": 0.4,
        "probability": 0.9,
        "slide_m": 0.005,
        "alternatives": (),
    }
    values["stamp"] = FrameStamp(1, captured_ns, captured_ns, "c")
    return GraspPlan(plan_id=plan_id, arm=arm, goal_id="g", **(values | changes))


def rejected(plan_id: str = "p1") -> GraspPlan:
    return plan(plan_id, status=Status.FAILED, reason="the goal is not on the thread", waypoints=())


class UnreliableArm(SimulatedPsm):
    """A simulated arm that a test can break."""

    readiness = Readiness.READY
    joints_read: Callable[[np.ndarray], np.ndarray] = staticmethod(lambda joints: joints)
    jaw_read: Callable[[float], float] = staticmethod(lambda jaw_rad: jaw_rad)
    late_ns, busy, still_since_ns, pedal = 0, False, 0, False

    def state(self, now_ns: int) -> ArmState:
        state = super().state(now_ns)
        reason = "" if self.readiness is Readiness.READY else "the clutch is pressed"
        joints = self.joints_read(state.joints)
        told = (now_ns - self.late_ns, joints, self.jaw_read(state.jaw_rad), self.readiness, reason)
        return ArmState(*told, busy=self.busy, still_since_ns=self.still_since_ns, pedal=self.pedal)


class Drive:
    """A bridge that is fed by hand, with everything it ever said."""

    def __init__(self, config: RobotBridgeConfig | None = None) -> None:
        self.backend = UnreliableArm()
        self.bridge = RobotBridge(config or RobotBridgeConfig(), self.backend)
        self.now_ns = EPOCH
        self.armings, self.arming_id = 0, "none"
        self.said: list[Output | CommandAnswer] = []
        self.tick(0)

    def feed(self, arrived: Received | Tick | Command) -> list[Output | CommandAnswer]:
        said = list(self.bridge.step(arrived))
        self.said += said
        return said

    def tick(self, elapsed_ns: int = TICK) -> RobotState | None:
        self.now_ns += elapsed_ns
        said = self.feed(Tick(self.now_ns))
        states = [o.message for o in said if isinstance(o, Output) and o.topic is ROBOT_STATE]
        return states[0] if states else None

    def state(self, elapsed_ns: int = TICK) -> RobotState:
        state = self.tick(elapsed_ns)
        assert state is not None
        return state

    def publish(self, *plans: GraspPlan) -> None:
        for message in plans:
            self.feed(Received(PLAN, "suturegrasp/lab/planner/main/plan", 0, message))

    def beat(
        self,
        plan_id: str = "p1",
        arm: str = "psm1",
        at_ns: int | None = None,
        arming_id: str | None = None,
        echo_ns: int | None = None,
        pressed: bool = False,
    ) -> None:
        """A heartbeat that answers the newest challenge, or `echo_ns`; with `at_ns` none, as before there were any."""
        newest_ns = self.states()[-1].challenge_ns if at_ns is None else 0
        heartbeat = Heartbeat(
            arm,
            plan_id,
            self.now_ns if at_ns is None else at_ns,
            arming_id or self.arming_id,
            newest_ns if echo_ns is None else echo_ns,
            pressed=pressed,
        )
        self.feed(Received(HEARTBEAT, "suturegrasp/lab/operator/psm1/heartbeat", 0, heartbeat))

    def arm(self, plan_id: str = "p1", arm: str = "psm1", instance: str = "psm1") -> CommandAnswer:
        self.armings += 1
        message = Arm(CommandHeader(f"arming-{self.armings}", self.now_ns + SECOND, "ann"), arm, plan_id)
        answer = self.feed(Command(ARM, instance, message, self.now_ns))[0]
        assert isinstance(answer, CommandAnswer)
        if answer.outcome is Outcome.ACCEPTED:
            self.arming_id = message.header.id
        return answer

    def hold(self, arm: str = "psm1") -> CommandAnswer:
        message = Hold(CommandHeader("h", self.now_ns + SECOND, "ann"), arm)
        answer = self.feed(Command(HOLD, "psm1", message, self.now_ns))[0]
        assert isinstance(answer, CommandAnswer)
        return answer

    def events(self) -> list[ExecutionEvent]:
        return [o.message for o in self.said if isinstance(o, Output) and o.topic is EXECUTION]

    def states(self) -> list[RobotState]:
        return [o.message for o in self.said if isinstance(o, Output) and o.topic is ROBOT_STATE]

    def run(self, ticks: int) -> None:
        """Go on with heartbeats at 20 Hz, until the plan ends."""
        for index in range(ticks):
            if index % 5 == 0:
                self.beat()
            self.tick()
            if self.events()[-1].kind in (ExecutionKind.FINISHED, ExecutionKind.HELD):
                return


def moving(ticks: int = 100) -> Drive:
    """In the midst of plan p1."""
    drive = Drive()
    drive.publish(plan())
    assert drive.arm().outcome is Outcome.ACCEPTED
    drive.run(ticks)
    assert drive.states()[-1].mode is RobotMode.MOVING
    return drive


def stands_still(drive: Drive, ticks: int = 50) -> bool:
    """Whether the arm rests from now on, heartbeats or not."""
    before = drive.state()
    for _ in range(ticks):
        drive.beat()
        after = drive.state()
        if not np.array_equal(before.joints, after.joints) or before.jaw_rad != after.jaw_rad:
            return False
    return True


def refusal(drive: Drive, **command: str) -> tuple[str, str]:
    """The code and the reason of a refused arming, which is an event as well."""
    answer = drive.arm(**command)
    assert answer.outcome is Outcome.REFUSED
    event = drive.events()[-1]
    assert (event.kind, event.code, event.reason) == (ExecutionKind.REFUSED, answer.code, answer.reason)
    assert stands_still(drive, 5)
    return answer.code, answer.reason


def test_an_armed_plan_is_carried_out_phase_by_phase_to_its_end() -> None:
    drive = Drive()
    drive.publish(plan())
    assert drive.arm() == CommandAnswer("arming-1", Outcome.ACCEPTED, "", "")
    drive.run(2000)
    kinds = [(event.kind, event.phase) for event in drive.events()]
    reached = [(ExecutionKind.PHASE_REACHED, phase) for phase in Phase]
    assert kinds == [(ExecutionKind.ACCEPTED, None), *reached, (ExecutionKind.FINISHED, None)]
    end = drive.state()
    assert (end.mode, end.plan_id) == (RobotMode.IDLE, "")
    # half a turn about the fingers is nearer from where the arm stood, and the same to a jaw
    as_planned = end.T_camera_base @ end.T_base_tool @ np.diag((-1.0, -1.0, 1.0, 1.0))
    np.testing.assert_allclose(as_planned, WAYPOINTS[-1].T_camera_tool, atol=1e-9)
    assert end.jaw_rad == pytest.approx(-0.2)


def test_the_state_is_told_in_every_tick_and_agrees_with_the_kinematics() -> None:
    drive = moving()
    assert len(drive.states()) == 101
    for state in drive.states():
        np.testing.assert_allclose(state.T_base_tool, forward(state.joints), atol=1e-15)
        np.testing.assert_array_equal(state.T_camera_base, SIMULATED_T_CAMERA_BASE)
    assert drive.states()[-1].measured_ns == drive.now_ns
    assert drive.states()[-1].plan_id == "p1"


def test_speed_limits_hold_between_any_two_states() -> None:
    drive = Drive()
    drive.publish(plan())
    drive.arm()
    drive.run(2000)
    limits, states = MotionLimits(), drive.states()
    joints = np.stack([state.joints for state in states])
    places = np.stack([state.T_base_tool[:3, 3] for state in states])
    jaw = np.array([state.jaw_rad for state in states])
    assert (np.abs(np.diff(joints, axis=0)) * 100 <= LARGE_NEEDLE_DRIVER.max_speeds).all()
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() * 100 <= limits.speed * 1.001
    assert np.abs(np.diff(jaw)).max() * 100 <= limits.jaw_speed * 1.001
    acceleration = np.linalg.norm(np.diff(places, 2, axis=0), axis=1) * 100**2
    assert acceleration.max() <= limits.acceleration * 1.01


def test_irregular_ticks_make_it_late_but_never_fast() -> None:
    drive = Drive()
    drive.publish(plan())
    drive.arm()
    elapsed = np.random.default_rng(7).choice((2_000_000, 10_000_000, 15_000_000, 90_000_000), 3000)
    for step in elapsed:
        before = drive.states()[-1]
        drive.beat()
        after = drive.state(int(step))
        assert (np.abs(after.joints - before.joints) <= LARGE_NEEDLE_DRIVER.max_speeds * step * 1e-9 + 1e-12).all()
        moved = np.linalg.norm(after.T_base_tool[:3, 3] - before.T_base_tool[:3, 3])
        assert moved <= MotionLimits().speed * 2 * TICK * 1e-9 * 1.001
    assert drive.events()[-1].kind is ExecutionKind.FINISHED


def test_an_arm_that_is_armed_or_simulated_or_another_one_changes_no_state() -> None:
    def change(drive: Drive, arm: str = "psm1") -> CommandAnswer:
        message = ChangeState(CommandHeader("c", drive.now_ns + SECOND, "ann"), arm, StateWord.HOME)
        answer = drive.feed(Command(CHANGE_STATE, "psm1", message, drive.now_ns))[0]
        assert isinstance(answer, CommandAnswer)
        return answer

    assert change(moving()).code == Code.BUSY
    assert change(Drive()).code == Code.NO_STATES
    assert change(Drive(), "psm2").code == Code.OTHER_ARM


def test_a_motion_goes_over_to_another_ratio_smoothly_and_takes_as_much_longer() -> None:
    drives = [Drive(RobotBridgeConfig(ratio=ratio)) for ratio in (1.0, 0.5, 0.5)]
    for drive in drives:
        drive.publish(plan())
        drive.arm()
        drive.run(40)
    drives[2].bridge.configure(RobotBridgeConfig(ratio=1.0))
    for drive in drives:
        drive.run(4000)
        assert drive.events()[-1].kind is ExecutionKind.FINISHED
        places = np.stack([state.T_base_tool[:3, 3] for state in drive.states()])
        assert np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() * 100**2 <= 1.5 * MotionLimits().acceleration
    full, half, changed = (len(drive.states()) for drive in drives)
    assert half > 1.9 * full
    assert full < changed < full + 60


def test_nothing_moves_between_arming_and_the_first_heartbeat() -> None:
    drive = Drive()
    drive.publish(plan())
    drive.arm()
    for _ in range(99):
        state = drive.state()
        assert (state.mode, state.plan_id) == (RobotMode.IDLE, "p1")
        np.testing.assert_array_equal(state.joints, drive.states()[0].joints)


def test_arming_lapses_where_no_heartbeat_follows() -> None:
    drive = Drive()
    drive.publish(plan())
    drive.arm()
    for _ in range(101):
        drive.tick()
    assert drive.events()[-1].code == Code.HEARTBEAT_LOST
    assert stands_still(drive)


def test_heartbeats_from_before_arming_count_for_nothing() -> None:
    drive = Drive()
    drive.publish(plan())
    drive.beat()
    drive.arm()
    drive.tick()
    assert drive.states()[-1].mode is RobotMode.IDLE


def test_a_heartbeat_of_an_earlier_arming_feeds_no_later_one_of_the_same_plan() -> None:
    drive = moving()
    earlier = drive.arming_id
    drive.hold()
    assert drive.arm().outcome is Outcome.ACCEPTED
    joints = drive.state().joints
    for _ in range(50):
        drive.beat(arming_id=earlier)
        state = drive.state()
        assert state.mode is RobotMode.IDLE
        assert np.array_equal(state.joints, joints)
    drive.beat()
    assert drive.state().mode is RobotMode.MOVING


def test_events_name_the_arming_that_they_are_of() -> None:
    drive = moving()
    drive.hold()
    drive.arm("p9")
    told = [(event.kind, event.arming_id) for event in drive.events()]
    assert told == [
        (ExecutionKind.ACCEPTED, "arming-1"),
        (ExecutionKind.HELD, "arming-1"),
        (ExecutionKind.REFUSED, "arming-2"),
    ]


def test_a_lost_heartbeat_holds_within_a_fifth_of_a_second_and_a_tick() -> None:
    drive = moving()
    drive.beat()
    last_beat_ns = drive.now_ns
    while drive.events()[-1].kind is not ExecutionKind.HELD:
        drive.tick()
    held = drive.events()[-1]
    assert (held.code, held.plan_id) == ("heartbeat_lost", "p1")
    assert held.at_ns - last_beat_ns <= 0.2 * SECOND + TICK
    assert drive.states()[-1].mode is RobotMode.HOLDING
    assert stands_still(drive)
    assert drive.states()[-1].mode is RobotMode.HOLDING


@pytest.mark.parametrize("wrong", [{"plan_id": "p2"}, {"arm": "psm2"}, {"at_ns": 5}])
def test_heartbeats_for_another_plan_or_arm_or_sent_before_count_for_nothing(wrong: dict[str, Any]) -> None:
    drive = moving()
    for _ in range(25):
        drive.beat(**wrong)
        drive.tick()
    assert drive.events()[-1].code == Code.HEARTBEAT_LOST


def test_a_loop_that_was_stalled_for_longer_than_the_dead_man_time_holds() -> None:
    drive = moving()
    drive.beat()
    drive.tick(SECOND // 4)
    assert drive.events()[-1].code == Code.HEARTBEAT_LOST


@pytest.mark.parametrize("off_s", [10, -10])
def test_it_does_not_matter_what_an_operators_clock_says(off_s: int) -> None:
    drive = moving()
    for _ in range(60):
        drive.beat(at_ns=drive.now_ns + off_s * SECOND, echo_ns=drive.states()[-1].challenge_ns)
        drive.tick()
    assert drive.states()[-1].mode is RobotMode.MOVING


def test_an_answer_is_as_young_as_the_challenge_that_it_echoes() -> None:
    drive = moving()
    last_ns = drive.states()[-1].challenge_ns
    while drive.events()[-1].kind is not ExecutionKind.HELD:
        drive.beat(echo_ns=last_ns)
        drive.tick()
    assert drive.events()[-1].at_ns - last_ns <= 0.2 * SECOND + TICK
    assert stands_still(drive)


def test_answers_that_take_too_long_are_named_with_how_long_they_take() -> None:
    drive = moving()
    issued = [state.challenge_ns for state in drive.states()]
    for _ in range(60):
        issued.append(drive.state().challenge_ns)
        drive.beat(echo_ns=issued[-31])
    held = drive.events()[-1]
    assert (held.kind, held.code) == (ExecutionKind.HELD, "round_trip")
    assert "take 300 ms from the bridge to whoever stands by and back" in held.reason


@pytest.mark.parametrize("echo_ns", [1, EPOCH + 3600 * SECOND, EPOCH + 1])
def test_a_challenge_that_was_never_issued_is_answered_by_nobody(echo_ns: int) -> None:
    drive = moving()
    for _ in range(25):
        drive.beat(echo_ns=echo_ns)
        drive.tick()
    assert drive.events()[-1].code == Code.HEARTBEAT_LOST


@pytest.mark.parametrize(("jump_s", "named"), [(10, "its clock was set, or it stood still"), (-10, "went backwards")])
def test_a_bridge_whose_clock_is_set_in_mid_motion_says_so(jump_s: int, named: str) -> None:
    drive = moving()
    drive.beat()
    drive.tick(jump_s * SECOND)
    assert drive.events()[-1].kind is ExecutionKind.HELD
    assert named in drive.events()[-1].reason


def test_a_hold_command_stops_at_once_and_disarms() -> None:
    drive = moving()
    before = drive.states()[-1]
    assert drive.hold().outcome is Outcome.ACCEPTED
    assert (drive.events()[-1].kind, drive.events()[-1].code) == (ExecutionKind.HELD, "hold_command")
    after = drive.state()
    np.testing.assert_array_equal(after.joints, before.joints)
    assert (after.mode, after.plan_id) == (RobotMode.HOLDING, "")
    assert stands_still(drive)


def test_a_hold_of_an_arm_that_rests_is_accepted_and_shows_in_its_mode() -> None:
    drive = Drive()
    assert drive.hold().outcome is Outcome.ACCEPTED
    assert drive.state().mode is RobotMode.HOLDING
    assert drive.events() == []


def test_a_hold_for_another_arm_is_refused() -> None:
    drive = moving()
    assert drive.hold("psm2").code == Code.OTHER_ARM
    drive.beat()
    assert drive.state().mode is RobotMode.MOVING


def test_after_a_hold_the_plan_goes_on_only_when_armed_again() -> None:
    drive = moving()
    drive.hold()
    assert stands_still(drive)
    assert drive.arm().outcome is Outcome.ACCEPTED
    drive.run(2000)
    assert drive.events()[-1].kind is ExecutionKind.FINISHED


def test_after_its_end_a_plan_does_not_run_again_by_itself() -> None:
    drive = moving()
    drive.run(2000)
    assert drive.events()[-1].kind is ExecutionKind.FINISHED
    assert stands_still(drive)


def test_a_plan_nobody_knows_is_refused() -> None:
    code, reason = refusal(Drive())
    assert code == "unknown_plan"
    assert "p1" in reason


def test_only_the_last_few_plans_are_known() -> None:
    drive = Drive()
    drive.publish(*(plan(f"p{index}") for index in range(1, 10)))
    assert refusal(drive, plan_id="p1")[0] == "unknown_plan"
    assert drive.arm("p9").outcome is Outcome.ACCEPTED


def test_plans_for_other_arms_and_rejected_ones_do_not_crowd_out_a_good_one() -> None:
    drive = Drive()
    drive.publish(plan(), *(plan(f"q{i}", arm="psm2") for i in range(30)), *(rejected(f"r{i}") for i in range(30)))
    assert drive.arm().outcome is Outcome.ACCEPTED


def test_the_latest_plan_of_an_id_counts() -> None:
    drive = Drive()
    drive.publish(plan(), rejected())
    code, reason = refusal(drive)
    assert code == "rejected_plan"
    assert "the goal is not on the thread" in reason
    drive.publish(plan())
    assert drive.arm().outcome is Outcome.ACCEPTED


def test_a_plan_or_a_command_for_another_arm_is_refused() -> None:
    drive = Drive()
    drive.publish(plan(arm="psm2"))
    assert refusal(drive)[0] == "other_arm"
    drive.publish(plan())
    assert refusal(drive, arm="psm2")[0] == "other_arm"
    assert refusal(drive, instance="psm2")[0] == "other_arm"


def test_a_plan_from_an_old_frame_or_from_the_future_is_refused() -> None:
    drive = Drive()
    drive.publish(plan(captured_ns=EPOCH - 31 * SECOND))
    code, reason = refusal(drive)
    assert code == "stale"
    assert "31.0 s old" in reason
    drive.publish(plan(captured_ns=EPOCH + 3 * SECOND))
    assert refusal(drive)[0] == "clock"


def test_a_plan_from_before_another_plans_motion_is_out_of_order_and_the_same_one_goes_on() -> None:
    drive = moving()
    drive.hold()
    drive.publish(plan("p2"), plan("p3", captured_ns=drive.now_ns))
    code, reason = refusal(drive, plan_id="p2")
    assert code == "out_of_order"
    assert "before the motion of plan p1 began" in reason
    assert drive.arm().outcome is Outcome.ACCEPTED, "what was held goes on"
    drive.hold()
    assert drive.arm("p3").outcome is Outcome.ACCEPTED


def test_what_was_held_at_the_thread_goes_on_only_from_a_frame_of_since() -> None:
    drive = moving()
    while not any(event.phase is Phase.APPROACH for event in drive.events()):
        drive.run(5)
    drive.hold()
    code, reason = refusal(drive)
    assert code == "out_of_order"
    assert "which may have moved the thread: plan again" in reason
    drive.publish(plan("p2", captured_ns=drive.now_ns))
    assert drive.arm("p2").outcome is Outcome.ACCEPTED


def tissue_before(drive: Drive, depth_m: float, calibration_id: str = "c") -> None:
    """Tell of flat tissue all over the image."""
    camera, stamp = RectifiedStereo(640, 480, 600.0, 600.0, 320.0, 240.0, 0.005, 1.0), drive.now_ns
    u_px, v_px = np.arange(5.0, 640, 10), np.arange(5.0, 480, 10)
    depth = np.full((len(v_px), len(u_px)), depth_m)
    of = FrameStamp(1, stamp, stamp, calibration_id)
    drive.feed(Received(SURFACE, "", 0, TissueSurface(of, camera, u_px, v_px, depth, depth > 0, 1e-3 * depth)))


def test_tissue_that_was_measured_before_something_was_moved_by_hand_speaks_for_and_against_nothing() -> None:
    drive = Drive()
    tissue_before(drive, 0.05)
    drive.publish(plan(captured_ns=drive.now_ns + TICK))
    assert refusal(drive)[0] == "tissue"
    drive.backend.still_since_ns = drive.now_ns
    drive.publish(plan(captured_ns=drive.now_ns))
    assert drive.arm().outcome is Outcome.ACCEPTED


@pytest.mark.parametrize("of", ["registered", "tissue"])
def test_a_plan_in_another_cameras_frame_than_base_or_tissue_is_refused(of: str) -> None:
    drive = Drive(RobotBridgeConfig(calibration_id="other" if of == "registered" else "c"))
    if of == "tissue":
        tissue_before(drive, 0.1, "other")
    drive.publish(plan())
    code, reason = refusal(drive)
    assert code == "wrong_frame"
    assert f"calibration c, and the {'arm was registered' if of == 'registered' else 'tissue was measured'}" in reason
    drive.publish(plan(captured_ns=EPOCH, stamp=FrameStamp(1, EPOCH, EPOCH, "other")))
    assert drive.arm().outcome is (Outcome.ACCEPTED if of == "registered" else Outcome.REFUSED)


def test_an_arm_in_motion_is_busy() -> None:
    drive = moving()
    drive.publish(plan("p2", captured_ns=drive.now_ns))
    assert drive.arm("p2").code == "busy"
    drive.run(2000)
    assert drive.events()[-1].kind is ExecutionKind.FINISHED


@pytest.mark.parametrize(
    ("point", "code"),
    [
        (waypoint((0, 0, 150), 0, Phase.APPROACH), "workspace"),
        (waypoint((1e306, 1e306, -1e306), 0, Phase.APPROACH), "workspace"),
        (waypoint((0, 0, 75), 2.0, Phase.APPROACH), "jaw_limit"),
        (Waypoint(transform(np.diag((1.0, -1, -1)), np.array((0, 0, 0.08))), 0, Phase.GRASP, None), "unreachable"),
    ],
)
def test_a_plan_that_the_arm_cannot_follow_is_refused_before_it_moves(point: Waypoint, code: str) -> None:
    drive = Drive()
    drive.publish(plan(waypoints=(point,)))
    assert refusal(drive)[0] == code


def test_a_plan_through_the_remote_centre_and_one_without_end_are_refused() -> None:
    roomy = MotionLimits(workspace_camera=np.array(((-1.0, -1, -1), (1, 1, 1))))
    drive = Drive(RobotBridgeConfig(limits=roomy))
    near = SIMULATED_T_CAMERA_BASE @ forward(np.array((0, 0, 0.0600, 0, 0, 0)))
    drive.publish(plan(waypoints=(Waypoint(near, 0.0, Phase.APPROACH, None),)))
    assert refusal(drive)[0] == "remote_centre"
    drive.publish(plan(waypoints=tuple(waypoint((x, 0, 75), 0.0, Phase.SLIDE) for x in (-20, 20) * 50)))
    assert refusal(drive)[0] == "too_long"


@pytest.mark.parametrize(
    ("readiness", "mode"), [(Readiness.DISABLED, RobotMode.DISABLED), (Readiness.FAULT, RobotMode.FAULT)]
)
def test_an_arm_that_is_not_ready_is_neither_armed_nor_moved(readiness: Readiness, mode: RobotMode) -> None:
    drive = moving()
    drive.backend.readiness = readiness
    assert drive.state().mode is mode
    assert (drive.events()[-1].kind, drive.events()[-1].code) == (ExecutionKind.HELD, "not_ready")
    code, reason = refusal(drive)
    assert code == "not_ready"
    assert "the clutch is pressed" in reason
    drive.backend.readiness = Readiness.READY
    assert drive.state().mode is RobotMode.HOLDING
    assert stands_still(drive)


def test_an_arm_that_reports_no_numbers_is_held_and_no_such_number_is_published() -> None:
    drive = moving()
    drive.backend.joints_read = lambda joints: joints * np.nan
    assert drive.state().mode is RobotMode.FAULT
    assert drive.events()[-1].code == "not_ready"
    assert all(np.isfinite(state.joints).all() for state in drive.states())
    assert refusal(drive)[0] == "not_ready"


def test_an_arm_that_never_reported_numbers_has_no_state_and_is_not_armed() -> None:
    drive = Drive()
    drive.backend = UnreliableArm()
    drive.backend.joints_read = lambda joints: joints * np.nan
    drive.bridge = RobotBridge(RobotBridgeConfig(), drive.backend)
    drive.publish(plan())
    assert drive.arm().code == "not_ready"
    assert drive.tick() is None
    assert drive.arm().code == "not_ready"


def test_an_arm_that_was_measured_too_long_ago_is_held() -> None:
    drive = moving()
    drive.backend.late_ns = SECOND // 5
    drive.beat()
    assert drive.state().mode is RobotMode.FAULT
    assert drive.events()[-1].code == "stale_state"


def test_an_arm_that_is_pushed_away_from_its_set_points_is_held() -> None:
    drive = moving()
    drive.backend.joints_read = lambda joints: joints + np.array((0, 0, 0.006, 0, 0, 0))
    drive.beat()
    drive.tick()
    assert drive.events()[-1].code == "not_following"


def test_an_arm_whose_jaw_does_not_follow_is_held_and_one_whose_jaw_lags_is_not() -> None:
    drive = moving()
    for behind_rad, held in ((0.25, False), (0.35, True)):
        drive.backend.jaw_read = lambda jaw_rad, behind_rad=behind_rad: jaw_rad - behind_rad
        drive.beat()
        drive.tick()
        assert (drive.events()[-1].code == "not_following") is held


def test_a_jaw_that_presses_on_what_it_holds_follows_well_enough() -> None:
    drive = moving()
    drive.backend.jaw_read = lambda jaw_rad: max(jaw_rad, 0.15)
    drive.run(3000)
    assert drive.events()[-1].kind is ExecutionKind.FINISHED


def test_an_arm_that_is_blocked_short_of_a_stop_is_held_after_a_second() -> None:
    drive = Drive()
    drive.publish(plan())
    drive.arm()
    drive.backend.joints_read = lambda joints: joints - np.array((0, 0, 0.001, 0, 0, 0))
    drive.run(2000)
    assert drive.events()[-1].code == "not_following"


def arrives(drive: Drive) -> bool:
    """Whether the first phase ends within a while, of an arm that stands where it does from now on."""
    for _ in range(40):
        drive.beat()
        drive.tick()
    return any(event.kind is ExecutionKind.PHASE_REACHED for event in drive.events())


def before_its_first_stop() -> Drive:
    """Armed with a plan of one place, where the arm stands, a tick before it is found there."""
    drive = Drive()
    T = SIMULATED_T_CAMERA_BASE @ forward(drive.states()[-1].joints)
    drive.publish(plan(waypoints=(Waypoint(T, 0.0, Phase.APPROACH, None),)))
    assert drive.arm().outcome is Outcome.ACCEPTED
    return drive


def test_no_phase_ends_while_the_arm_is_busy_with_a_motion_of_its_own() -> None:
    drive = before_its_first_stop()
    drive.backend.busy = True
    assert not arrives(drive)
    drive.backend.busy = False
    assert arrives(drive)


def test_a_phase_ends_by_a_measurement_that_is_later_than_the_last_set_point() -> None:
    drive = before_its_first_stop()
    measured_ns = drive.now_ns + 5 * TICK
    drive.backend.late_ns = 9 * TICK
    for _ in range(9):
        drive.beat()
        drive.tick()
        first = next((e for e in drive.events() if e.kind is ExecutionKind.PHASE_REACHED), None)
        assert first is None, (first, measured_ns)
    assert arrives(drive)


def test_a_clock_that_goes_backwards_holds() -> None:
    drive = moving()
    drive.tick(-1)
    assert drive.events()[-1].code == "clock"
    assert stands_still(drive)


def test_two_runs_say_the_same_bytes() -> None:
    def run() -> list[bytes]:
        drive = moving(150)
        drive.hold()
        drive.tick()
        drive.arm()
        drive.run(2000)
        return [encode(said.message if isinstance(said, Output) else said) for said in drive.said]

    first = run()
    assert len(first) > 500
    assert first == run()


def test_the_bridge_is_named_after_its_arm_and_listens_to_that_arms_heartbeat() -> None:
    bridge = RobotBridge(RobotBridgeConfig(arm="psm2"), SimulatedPsm())
    assert (bridge.kind, bridge.instance) == ("robot_bridge", "psm2")
    heard = [(entry.topic, entry.instance) for entry in bridge.inputs]
    assert heard == [(PLAN, "main"), (HEARTBEAT, "psm2"), (SURFACE, "main"), (FRAME_NOTICE, "main")]


def test_an_arm_has_all_turns_as_soon_as_it_is_armed_and_few_once_it_rests() -> None:
    drive = Drive()
    assert drive.bridge.tick_hz == 100
    drive.tick(2 * SECOND)
    assert drive.bridge.tick_hz == ROBOT_STATE.resting_hz
    drive.publish(plan(captured_ns=drive.now_ns))
    drive.now_ns += SECOND // 20
    assert drive.arm().outcome is Outcome.ACCEPTED
    assert drive.bridge.tick_hz == 100
    drive.run(2000)
    assert drive.events()[-1].kind is ExecutionKind.FINISHED
    assert drive.bridge.tick_hz == 100
    drive.tick()
    drive.tick(2 * SECOND)
    assert drive.bridge.tick_hz == ROBOT_STATE.resting_hz


def test_an_arm_that_is_moved_by_others_has_all_turns() -> None:
    drive = Drive()
    drive.tick(2 * SECOND)
    for step in range(5):
        drive.backend.joints_read = lambda joints, step=step: joints + 1e-3 * (step + 1)
        drive.tick(SECOND // 10)
    assert drive.bridge.tick_hz == 100
    drive.tick(2 * SECOND)
    assert drive.bridge.tick_hz == ROBOT_STATE.resting_hz


def test_an_arm_that_broke_since_its_last_turn_is_not_armed() -> None:
    drive = Drive()
    drive.tick(2 * SECOND)
    drive.publish(plan(captured_ns=drive.now_ns))
    drive.now_ns += SECOND // 20
    drive.backend.readiness = Readiness.DISABLED
    answer = drive.arm()
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "not_ready")


@pytest.mark.parametrize("name", ["dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "tick_hz", "resting_hz"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_time_that_makes_no_sense_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(RobotBridgeError, match=name):
        dataclasses.replace(RobotBridgeConfig(), **{name: value})


def test_a_base_that_is_no_rigid_transform_is_refused() -> None:
    with pytest.raises(RobotBridgeError, match="T_camera_base"):
        RobotBridgeConfig(T_camera_base=np.diag((1.0, 1, 2, 1)))


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
    st.tuples(st.just("plan"), st.sampled_from(PLANS)),
    st.tuples(st.just("arm"), plan_ids, arms),
    st.tuples(st.just("beat"), plan_ids, arms, st.integers(-(2**63), 2**63 - 1)),
    st.tuples(st.just("hold"), arms),
    st.tuples(st.just("break"), st.sampled_from(Readiness)),
)


class Watch:
    """An account of its own of when the arm may move: armed, and a heartbeat within 0.2 s, at the tick before."""

    def __init__(self) -> None:
        self.drive = Drive()
        self.drive.publish(plan())
        self.armed = ""
        self.beat_ns: int | None = None
        self.newest_beat = -(2**63) - 1
        self.allowed = False

    def tick(self, elapsed_ns: int) -> None:
        before, events = self.drive.states()[-1], len(self.drive.events())
        after = self.drive.state(elapsed_ns)
        same = np.array_equal(before.joints, after.joints) and before.jaw_rad == after.jaw_rad
        assert same or self.allowed
        reach = LARGE_NEEDLE_DRIVER.max_speeds * max(elapsed_ns, 0) * 1e-9
        assert (np.abs(after.joints - before.joints) <= reach + 1e-12).all()
        last = {event.kind for event in self.drive.events()[events:]}
        if last & {ExecutionKind.HELD, ExecutionKind.FINISHED}:
            self.armed = ""
        live = self.beat_ns is not None and self.drive.now_ns - self.beat_ns <= 0.2 * SECOND
        self.allowed = bool(self.armed) and live

    def act(self, action: tuple[Any, ...]) -> None:
        drive = self.drive
        match action:
            case ("tick", elapsed_ns, times):
                for _ in range(times):
                    self.tick(elapsed_ns)
            case ("go", times):
                for _ in range(times):
                    self.beat(self.armed or "p1", "psm1", drive.now_ns)
                    self.tick(TICK)
            case ("plan", message):
                drive.publish(message)
            case ("arm", plan_id, arm):
                if drive.arm(plan_id, arm).outcome is Outcome.ACCEPTED:
                    assert not self.armed
                    self.armed, self.beat_ns, self.newest_beat = plan_id, None, -(2**63) - 1
            case ("beat", plan_id, arm, at_ns):
                self.beat(plan_id, arm, at_ns)
            case ("hold", arm):
                if drive.hold(arm).outcome is Outcome.ACCEPTED:
                    self.armed, self.allowed = "", False
            case ("break", readiness):
                drive.backend.readiness = readiness
            case _:
                raise AssertionError(action)

    def beat(self, plan_id: str, arm: str, at_ns: int) -> None:
        self.drive.beat(plan_id, arm, at_ns)
        if (plan_id, arm) == (self.armed, "psm1") and at_ns > self.newest_beat:
            self.beat_ns, self.newest_beat = self.drive.now_ns, at_ns


@settings(max_examples=60, deadline=None)
@given(st.booleans(), st.lists(actions, max_size=40))
def test_whatever_arrives_it_answers_and_moves_only_while_armed_with_a_live_heartbeat(
    under_way: bool, sequence: list[tuple[Any, ...]]
) -> None:
    watch = Watch()
    if under_way:
        watch.act(("arm", "p1", "psm1"))
        watch.act(("go", 50))
    for action in sequence:
        watch.act(action)
    for said in watch.drive.said:
        encode(said.message if isinstance(said, Output) else said)


def test_the_watch_of_the_hostile_test_would_notice_a_motion() -> None:
    watch = Watch()
    watch.act(("arm", "p1", "psm1"))
    watch.act(("go", 60))
    assert watch.allowed
    watch.allowed = False
    with pytest.raises(AssertionError):
        watch.act(("go", 1))


def test_the_documentation_explains_every_code() -> None:
    text = (pathlib.Path(__file__).parents[3] / "docs/robot_bridge.md").read_text()
    assert [code for code in Code if f"`{code.value}`" not in text] == []


def test_heartbeats_that_were_long_on_their_way_or_are_played_again_keep_nothing_moving() -> None:
    drive = moving()
    hour_ns = 3600 * SECOND
    for _ in range(60):
        drive.tick()
        drive.beat(at_ns=drive.now_ns - hour_ns)
    assert drive.events()[-1].kind is ExecutionKind.HELD
    assert drive.events()[-1].code == "heartbeat_lost"
    assert stands_still(drive)


def test_a_failure_within_a_turn_disarms_and_nothing_moves_when_it_is_over() -> None:
    drive = moving()

    def broken(_: np.ndarray) -> np.ndarray:
        raise OSError("the link to the arm broke")

    drive.backend.joints_read = broken
    with pytest.raises(OSError, match="the link"):
        drive.tick()
    drive.backend.joints_read = staticmethod(lambda joints: joints)
    drive.beat()
    assert drive.state().mode is RobotMode.HOLDING
    assert stands_still(drive)


def test_a_plan_that_was_finished_cannot_be_armed_again() -> None:
    drive = moving()
    drive.run(3000)
    assert drive.events()[-1].kind is ExecutionKind.FINISHED
    assert drive.arm().code == "unknown_plan"


def test_a_bridge_that_is_closed_lets_the_arm_rest() -> None:
    drive = moving()
    drive.bridge.close()
    assert stands_still(drive)
