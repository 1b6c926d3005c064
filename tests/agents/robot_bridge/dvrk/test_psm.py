"""A plan on an emulated dVRK by either codec, and everything for which the bridge must not move it, or stop."""

import re
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh

from agents.cli.recordings.replay_through import with_simulated_arms
from agents.cli.rig.builders import build
from agents.cli.rig.config import RigConfig
from agents.emulator.messages import OperatingState, header
from agents.robot_bridge.agent import RobotBridge
from agents.robot_bridge.backend import Readiness
from agents.robot_bridge.dvrk.set_points import SETTLES_NS
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import (
    Arm,
    ChangeState,
    CommandHeader,
    ExecutionKind,
    FrameStamp,
    Hold,
    Outcome,
    Phase,
    RectifiedStereo,
    RobotMode,
    StateWord,
    TissueSurface,
)
from schemas.topics import ARM, CHANGE_STATE, HOLD, SURFACE
from shared.clock import monotonic_s, now_ns
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.ros import crtk
from shared.ros.far_clock import WINDOW_NS, FarClock
from shared.ros.naming import RmwZenoh, Role
from shared.ros.types import JOINT_STATE
from shared.runtime.access import access_control
from shared.runtime.agent import Command, Received
from shared.runtime.config import load_config

SECOND_NS, DEADLINE_S = 10**9, 20.0
ON_ITS_WAY_NS = 50 * 10**6
REPOSITORY = Path(__file__).parents[4]


def moves(lab):
    """Arm a plan and wait until the arm moves."""
    lab.ready()
    answer = lab.arm()
    assert answer.outcome is Outcome.ACCEPTED, answer.reason
    lab.until(lambda: lab.verdict()["set_points"] > 40)


def held(lab):
    """Wait until the bridge holds; the event."""
    lab.until(lambda: any(e.kind is ExecutionKind.HELD for e in lab.events()))
    return next(e for e in lab.events() if e.kind is ExecutionKind.HELD)


@pytest.mark.parametrize("codec", ["ros2dds", "rmw_zenoh"])
def test_capture_slide_and_grasp_without_an_unsafe_set_point(lab):
    moves(lab)
    lab.until(lambda: lab.events()[-1].kind is ExecutionKind.FINISHED)
    reached = [e.phase for e in lab.events() if e.kind is ExecutionKind.PHASE_REACHED]
    assert reached == [Phase.APPROACH, Phase.CAPTURE, Phase.SLIDE, Phase.GRASP]
    # a joint follows the last set point a little late
    lab.until(lambda: abs(lab.verdict()["position"][6] + 0.2) < 5e-3)
    verdict = lab.verdict()
    assert verdict["unsafe"] == 0, verdict["sentences"]
    state = lab.states()[-1]
    assert np.abs(state.joints - verdict["position"][:6]).max() < 1e-3
    told, sent = len(lab.states()), verdict["set_points"] / 2
    assert 0.4 * sent < told < 0.8 * sent, "the state is told half as often as set points go out"
    # nothing executes later
    lab.stands_by = False
    ended_ns = now_ns()
    lab.until(lambda: now_ns() - ended_ns > 0.3 * SECOND_NS)
    assert lab.verdict()["set_point_ns"] < ended_ns + 0.05 * SECOND_NS


@pytest.mark.parametrize(
    ("word", "reason", "mode"),
    [
        # state and error come as two messages
        ("fault", "an error was asked for|state is FAULT", RobotMode.FAULT),
        ("error", "an error was asked for|state is FAULT", RobotMode.FAULT),
        ("mute", "was not measured|does not follow", RobotMode.FAULT),
        ("stick", "does not follow", RobotMode.HOLDING),
        ("teleop", "teleoperation is on", RobotMode.DISABLED),
        ("narrow", "does not follow", RobotMode.HOLDING),
    ],
)
def test_what_goes_wrong_at_the_robot_stops_the_motion(lab, word, reason, mode):
    moves(lab)
    lab.ask(word)
    event = held(lab)
    assert re.search(reason, event.reason)
    lab.until(lambda: lab.states()[-1].mode is mode)
    lab.until(lambda: lab.verdict()["held_ns"])
    assert lab.arm().outcome is Outcome.REFUSED or mode is RobotMode.HOLDING or word == "error"
    assert lab.verdict()["unsafe"] == 0 or word == "fault", "set points on their way when the console failed"
    # the guard stamps what was on its way to it
    assert max(lab.verdict()["sent_ns"]) <= event.at_ns + ON_ITS_WAY_NS


@pytest.mark.parametrize(
    ("topic", "ros", "code", "reason"),
    [
        (
            "jaw/move_jp",
            crtk.joint_command(np.array([0.5]), 0),
            "other_owner",
            "somebody else commands it by PSM1/jaw/",
        ),
        ("free", crtk.empty(), "other_owner", "somebody else commands it by PSM1/free"),
    ],
)
def test_another_one_who_commands_ends_ours_and_keeps_us_out(lab, topic, ros, code, reason):
    moves(lab)
    lab.session.put(f"PSM1/{topic}", ros)
    assert reason in held(lab).reason
    answer = lab.arm()
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, code)


def test_a_hold_that_somebody_else_says_ends_ours(lab):
    moves(lab)
    lab.session.put("PSM1/hold", crtk.empty())
    assert (held(lab).code, "the guard holds the arm: somebody said hold" in held(lab).reason) == ("hold_command", True)


@pytest.mark.parametrize("codec", ["ros2dds", "rmw_zenoh"])
def test_another_one_who_could_command_is_enough_to_refuse(lab, codec):
    lab.ready()
    announced = "@/abc/@ros2_lv/MP/PSM1§servo_jp/sensor_msgs§msg§JointState/:::"
    if codec == "rmw_zenoh":
        announced = RmwZenoh(3).token("abc", 7, Role.PUBLISHER, "PSM1/servo_cp", JOINT_STATE, False) or ""
    with lab.session.liveliness().declare_token(announced):
        lab.until(lambda: lab.arm().code == "other_owner")
        assert "somebody else could command it" in lab.arm().reason
    lab.ready()


def test_teleoperation_keeps_us_out_where_the_console_says_so_and_where_it_does_not(lab):
    lab.ready()
    ready_ns = now_ns()
    lab.until(lambda: now_ns() - ready_ns > SETTLES_NS)
    for word, code, reason in (
        ("drift", "other_set_point", "heads for"),
        ("teleop", "other_owner", "teleoperation is"),
    ):
        lab.ask(word)
        lab.until(lambda reason=reason: reason in lab.backend.state(now_ns()).reason)
        answer = lab.arm()
        assert (answer.code, reason in answer.reason) == (code, True)
        if word == "drift":
            lab.ready()
    lab.ask("no_teleop")
    lab.ready()
    lab.backend._readings.hear_teleoperation(b"", 0)
    assert lab.arm().code == "other_owner", "what cannot be read may say so"
    assert lab.verdict()["set_points"] == 0


def test_a_grasp_whose_fingers_would_go_through_the_tissue_is_refused_and_nothing_is_sent(lab):
    def seen_at(depth_m):
        camera, at_ns = RectifiedStereo(640, 480, 600.0, 600.0, 320.0, 240.0, 0.005, 1.0), now_ns()
        u, v = np.arange(5.0, 640, 10), np.arange(5.0, 480, 10)
        depth = np.full((len(v), len(u)), depth_m)
        surface = TissueSurface(FrameStamp(1, at_ns, at_ns, "c"), camera, u, v, depth, depth > 0, 1e-3 * depth)
        lab.said += lab.bridge.step(Received(SURFACE, "", 0, surface))

    lab.ready()
    seen_at(0.07)
    answer = lab.arm()
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "tissue")
    assert "behind the tissue" in answer.reason
    assert lab.verdict()["set_points"] == 0
    seen_at(0.09)
    assert lab.arm().outcome is Outcome.ACCEPTED


@pytest.mark.parametrize("dry_run", [True])
def test_a_dry_run_checks_all_of_a_motion_and_sends_nothing(lab):
    lab.ready()
    answer = lab.arm()
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "dry_run")
    assert "passes every check" in answer.reason
    lab.until(lambda: len(lab.states()) > 3)
    verdict = lab.verdict()
    assert (verdict["set_points"], verdict["held_ns"]) == (0, 0)
    lab.backend.move(np.zeros(6), 0.0, "a")
    lab.backend.hold()
    assert lab.backend.change_state(StateWord.HOME, now_ns()) == "nothing is sent in a dry run"


def test_a_console_that_was_not_ready_for_a_moment_between_two_turns_ends_the_motion(lab):
    moves(lab)
    for paused in (True, False):
        state = OperatingState(header(now_ns()), "PAUSED" if paused else "ENABLED", True, False)
        lab.backend._readings.hear_state(state.serialize(), now_ns())
    assert (held(lab).code, lab.backend._readings._said.operating.state) == ("not_enabled", "ENABLED")


def test_only_an_arm_that_is_not_busy_with_what_is_not_ours_is_armed(lab):
    lab.ready()
    lab.backend._readings.hear_state(OperatingState(header(now_ns()), "ENABLED", True, True).serialize(), now_ns())
    answer = lab.arm()
    assert (answer.code, "busy with a motion that is not ours" in answer.reason) == ("other_owner", True)


def say_pose(lab, T):
    """Have the backend hear of a tool that is elsewhere than its joints say."""
    lab.backend._readings.hear("local/measured_cp", crtk.pose_command(T, now_ns()), now_ns())


def test_a_console_that_is_disabled_has_another_tool_or_is_elsewhere_is_not_armed(lab, caplog):
    caplog.set_level("INFO", "suturegrasp.robot_bridge.psm1")
    lab.ready()
    arm = lab.console._arm
    for word, back, reason in (("disable", "enable", "DISABLED, not ENABLED"), ("pause", "resume", "PAUSED")):
        arm.command(word)
        lab.until(lambda: lab.arm().code == "not_enabled")
        assert reason in lab.arm().reason
        arm.command(back)
        lab.ready()
    lab.ready()
    lab.turn()
    told = [record.getMessage() for record in caplog.records if record.name == "suturegrasp.robot_bridge.psm1"]
    assert any("PAUSED" in line for line in told)
    assert told[-1] == "the arm is ready"
    assert len(told) < 20, "not at every turn"
    arm.is_homed = False
    lab.until(lambda: lab.arm().code == "not_homed")
    arm.is_homed = True
    lab.ready()
    lab.ask("unreached")
    lab.until(lambda: lab.arm().code == "goal_not_reached")
    lab.ready()
    lab.backend._readings.hear_tool(b"", 0)
    assert "its tool is something not readable" in lab.arm().reason
    assert lab.arm().code == "wrong_tool"
    lab.backend._readings._tool = ""
    lab.backend._readings.hear("local/measured_cp", b"\0\1\0\0", 0)
    lab.ready()
    # as often as the console tells the right one
    beside = lab.backend.kinematics.forward(np.array((0.0, 0, 0.1, 0, 0, 0)))
    lab.until(lambda: (say_pose(lab, beside), lab.arm().code)[1] == "other_pose")
    lab.ready()
    lab.ask("fault")
    lab.until(lambda: lab.arm().code == "error_state")
    arm.command("enable")
    lab.ready()
    lab.ask("mute")
    lab.until(lambda: lab.arm().code == "stale_state")


def test_a_person_may_change_an_arms_state_while_it_is_disarmed_and_nobody_else_has_it(lab, monkeypatch):
    def change(word):
        header = CommandHeader(f"{word}-{now_ns()}", now_ns() + SECOND_NS, "ann")
        said = lab.bridge.step(Command(CHANGE_STATE, "psm1", ChangeState(header, "psm1", StateWord[word]), now_ns()))
        return next(iter(said))

    lab.ready()
    arm = lab.console._arm
    assert "PAUSED" in change("RESUME").reason, "it is not paused"
    for word, state in (("PAUSE", "PAUSED"), ("RESUME", "ENABLED"), ("DISABLE", "DISABLED"), ("ENABLE", "ENABLED")):
        lab.until(lambda word=word: change(word).outcome is Outcome.ACCEPTED)
        lab.until(lambda state=state: arm.state == state)
    lab.bridge.configure(replace(lab.bridge.config, ratio=0.3))
    lab.until(lambda: change("HOME").outcome is Outcome.ACCEPTED)
    lab.until(lambda: arm._ratio == 0.3)
    lab.until(lambda: not arm.is_homed and "not homed" in lab.backend.state(now_ns()).reason)
    assert lab.arm().code == "not_homed"
    lab.until(lambda: lab.events() and lab.events()[-1].plan_id == "state home")
    assert (lab.events()[-1].kind, arm.is_homed) == (ExecutionKind.FINISHED, True)
    lab.ready()
    arm.command = lambda _word: None
    assert change("PAUSE").outcome is Outcome.ACCEPTED
    monkeypatch.setattr("agents.robot_bridge.state_changes.LIMIT_S", 0.1)
    lab.until(lambda: lab.events()[-1].code == "state_not_reached")
    with lab.session.liveliness().declare_token("@/abc/@ros2_lv/MP/PSM1§servo_jp/sensor_msgs§msg§JointState/:::"):
        lab.until(lambda: "somebody else" in change("HOME").reason)
    lab.ready()
    moves(lab)
    answer = change("HOME")
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "busy")
    assert arm.is_homed
    assert lab.verdict()["unsafe"] == 0


def test_when_something_was_measured_is_told_by_the_robots_own_clock():
    clock, ahead = FarClock(), 5_000 * SECOND_NS
    for i in range(100):
        stamp, delay = i * 10**7, 10**6 + (i % 7) * 10**5
        assert 0 <= clock.measured_ns(stamp + ahead, stamp + delay) - stamp <= 1.7e6
    # a link that kept messages back lets them go at once
    late = 101 * 10**7
    assert late + SECOND_NS - clock.measured_ns(late + ahead, late + SECOND_NS) > 0.99 * SECOND_NS
    # a slow link that stays slow is soon taken for what it is
    starts = [2 * SECOND_NS + i * (WINDOW_NS + 1) for i in range(3)]
    after = [clock.measured_ns(at + ahead, at + 5 * 10**7) - at for at in starts]
    assert after[-1] == 5 * 10**7
    assert clock.measured_ns(0, 12) == 12


def test_a_replayed_time_reaches_no_robot_and_no_replay_has_one(lab):
    lab.backend.state(now_ns() - 3600 * SECOND_NS)
    lab.backend.move(np.zeros(6), 0.0, "a")
    assert lab.backend.state(0).readiness is Readiness.DISABLED
    base, endpoint = SIMULATED_T_CAMERA_BASE.tolist(), {"endpoint": "tcp/127.0.0.1:7"}
    arm = {"backend": "dvrk", "T_camera_base": base, "dvrk": endpoint}
    config = with_simulated_arms(RigConfig.model_validate({"robot": {"psm1": arm}}))
    bridge = build(config, "robot_bridge", "psm1")
    assert isinstance(bridge, RobotBridge)
    assert isinstance(bridge._backend, SimulatedPsm)
    verdict = lab.verdict()
    assert (verdict["set_points"], verdict["held_ns"]) == (0, 0)


def test_the_example_with_an_emulated_arm_has_it_where_the_simulated_one_stands():
    arm = load_config(REPOSITORY / "deploy" / "emulated.toml", RigConfig).robot["psm1"]
    assert arm.dvrk is not None
    assert arm.T_camera_base is not None
    assert np.abs(np.array(arm.T_camera_base) - SIMULATED_T_CAMERA_BASE).max() < 1e-8


def test_a_bridge_that_is_stopped_in_mid_motion_holds(lab):
    moves(lab)
    lab.bridge.close()
    until(lambda: lab.verdict()["held_ns"])
    assert lab.verdict()["unsafe"] == 0


def until(condition):
    """Wait for a condition without a turn of the bridge."""
    deadline_s, turn = monotonic_s() + DEADLINE_S, threading.Event()
    while not condition():
        assert monotonic_s() < deadline_s
        turn.wait(0.01)


def test_the_rigs_access_rules_allow_nothing_of_the_robots_keys():
    names = ["robot_bridge.psm1", "operator.desk", "planner.main", "viewer.desk"]
    allowed = [zenoh.KeyExpr(k) for rule in access_control("lab", names)["rules"] for k in rule["key_exprs"]]
    robots = ("PSM1/servo_jp", "guarded/PSM1/servo_jp", RmwZenoh().key("PSM1/servo_jp", JOINT_STATE))
    assert allowed
    assert not any(one.intersects(zenoh.KeyExpr(robot)) for one in allowed for robot in robots)


def test_a_hold_is_said_whatever_time_it_is_for_the_bridge(lab):
    lab.ready()
    # as after a tick that stalled, and as while a recording is replayed
    lab.backend.state(now_ns() - 3 * SECOND_NS)
    lab.backend.hold()
    lab.until(lambda: lab.verdict()["held_ns"])
    assert lab.backend.change_state(StateWord.PAUSE, now_ns()) == ""
    lab.until(lambda: lab.verdict()["state"] == "PAUSED")


def test_without_a_living_guard_a_real_arm_is_not_armed_and_does_not_go_on(lab):
    moves(lab)
    lab.guard._stopped.set()
    event = held(lab)
    assert (event.code, "no guard stands by" in event.reason) == ("no_guard", True)
    assert lab.arm().code == "no_guard"


def test_a_motion_ends_where_the_link_to_the_robot_broke_though_it_is_there_again_at_once(lab):
    moves(lab)
    lab.backend._link.broken += 1
    event = held(lab)
    assert (event.code, "the link to the robot broke" in event.reason) == ("stale_state", True)


def test_a_process_that_beats_by_itself_arms_no_real_arm(lab):
    lab.ready()
    lab.arm()
    lab.bridge.step(Command(HOLD, "psm1", Hold(CommandHeader("h", now_ns() + SECOND_NS, "ann"), "psm1"), now_ns()))
    lab.ready()
    header = CommandHeader("alone", now_ns() + SECOND_NS, "ann")
    answer, *_ = lab.bridge.step(Command(ARM, "psm1", Arm(header, "psm1", "p", lab.echo()[0]), now_ns()))
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "no_presence")


def test_what_a_real_arm_needs_to_know_and_does_not_speaks_against_arming_with_what_to_do(lab):
    lab.ready()
    lab.backend._has_no = frozenset()
    answer = lab.arm()
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, "unknown")
    # the emulated console says whether its teleoperation is on, and where its endoscope is, and nobody pressed a pedal
    assert "press the clutch once" in answer.reason
    for word in ("clutch", "unclutch"):
        lab.ask(word)
    lab.until(lambda: "clutch" not in lab.backend._untold())
    lab.ready()
    lab.until(lambda: lab.arm().outcome is Outcome.ACCEPTED)
