"""A plan on an emulated dVRK by either codec, and everything for which the bridge must not move it, or stop."""

import contextlib
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zenoh

from agents.cli.recordings.recompute import with_simulated_arms
from agents.configuration.rig import RigConfig
from agents.configuration.sections import DvrkSection
from agents.diagnostics.doctor.console import CONFORMANCE, Told, judged, listening
from agents.dvrk_emulator.console import Behaviour, EmulatedConsole
from agents.dvrk_emulator.messages import OperatingState, header
from agents.dvrk_emulator.oracle import Field, Oracle
from agents.dvrk_emulator.wire import BridgeWire, RmwWire
from agents.launch.builders import build
from agents.robot_bridge.agent import RobotBridge
from agents.robot_bridge.backend import Readiness
from agents.robot_bridge.dvrk.psm import DvrkPsm
from agents.robot_bridge.dvrk.set_points import SETTLES_NS
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import Arm, ChangeState, ExecutionKind, Hold, Outcome, Phase, RobotMode, StateWord
from schemas.topics import ARM, CHANGE_STATE, HOLD
from shared.clock import now_ns
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.ros import crtk
from shared.ros.far_clock import WINDOW_NS, FarClock
from shared.ros.naming import RmwZenoh, Role, Ros2dds
from shared.ros.types import JOINT_STATE
from shared.runtime.access import access_control
from shared.runtime.config import load_config
from shared.runtime.session import SessionSettings
from tests.rigs.robot.world import EPOCH_NS, TOOL, Link

SECOND_NS = 10**9
SOMEBODY = "@/abc/@ros2_lv/MP/PSM1§servo_jp/sensor_msgs§msg§JointState/:::"
"""Says, to the codec ros2dds, that it could command the arm."""


def held(room):
    """Wait until the bridge holds; the event."""
    room.until(lambda: room.events and room.events[-1].kind is ExecutionKind.HELD)
    return room.events[-1]


def says_state(room, *state):
    """Have the console tell of its operating state: its word, whether it is homed, and busy."""
    room.topics.tell_bridge("PSM1/operating_state", OperatingState(header(room.now_ns), *state).serialize())


def test_capture_slide_and_grasp_without_an_unsafe_set_point(room):
    room.starts_moving()
    room.until(lambda: not room.moves)
    assert room.events[-1].kind is ExecutionKind.FINISHED, room.events[-1].reason
    reached = [e.phase for e in room.events if e.kind is ExecutionKind.PHASE_REACHED]
    assert reached == [Phase.APPROACH, Phase.CAPTURE, Phase.SLIDE, Phase.GRASP]
    room.tick(4)
    verdict = room.verdict()
    assert verdict["unsafe"] == 0, verdict["sentences"]
    assert np.abs(room.state.joints - verdict["position"][:6]).max() < 1e-3
    assert verdict["position"][6] == pytest.approx(-0.2, abs=5e-3)
    # nothing executes later
    room.stands_by = False
    room.tick(60)
    assert room.verdict()["set_points"] == verdict["set_points"]


def test_while_a_plan_is_carried_out_the_emulated_console_does_all_that_doctor_asks_of_one(room):
    told = Told(DvrkSection(endpoint="tcp/127.0.0.1:7447", tool=TOOL))
    room.topics.attend(listening(told), lambda _token, _comes: None)
    room.starts_moving()
    room.until(lambda: not room.moves)
    assert {one.what: one.state for one in judged(told)} == {
        "PSM1": "ok",
        **{f"PSM1: {duty}": "ok" for duty in CONFORMANCE},
    }


# who else commands the arm


@pytest.mark.parametrize("codec", ["ros2dds", "rmw_zenoh"])
def test_another_one_who_could_command_is_enough_to_refuse(session, settings, until, codec):
    wire, naming, announced = BridgeWire(session), Ros2dds(), SOMEBODY
    if codec == "rmw_zenoh":
        wire, naming = RmwWire(session, 3), RmwZenoh(3)
        announced = naming.token("abc", 7, Role.PUBLISHER, "PSM1/servo_cp", JOINT_STATE, False)
    console = EmulatedConsole(wire, "PSM1", Oracle(Field(SIMULATED_T_CAMERA_BASE), False), Behaviour(ready=True))
    backend = DvrkPsm("PSM1", settings, naming, TOOL, dry_run=False)

    def says(reason):
        console.turn(0.005)
        return reason in backend.state(now_ns()).reason

    with contextlib.closing(console), contextlib.closing(backend):
        until(lambda: says("no guard stands by"), "that nothing else speaks against moving")
        with session.liveliness().declare_token(announced):
            until(lambda: says("somebody else could command it"))
        until(lambda: says("no guard stands by"))


@pytest.mark.parametrize("topic", ["jaw/move_jp", "free"])
def test_another_one_who_commands_ends_ours_and_keeps_us_out(room, topic):
    room.starts_moving()
    room.topics.tell_bridge(f"PSM1/{topic}", crtk.joint_command(np.array([0.5]), 0))
    assert f"somebody else commands it by PSM1/{topic}" in held(room).reason
    assert room.try_to_arm().code == "other_owner"


def test_teleoperation_keeps_us_out_where_the_console_says_so_and_where_it_does_not(room):
    room.ready()
    room.tick(round(200 * SETTLES_NS / SECOND_NS) + 1)
    for word, code, reason in (
        ("drift", "other_set_point", "heads for"),
        ("teleop", "other_owner", "teleoperation is"),
    ):
        room.console.request(word)
        room.until(lambda reason=reason: reason in room.backend.state(room.now_ns).reason)
        answer = room.try_to_arm()
        assert (answer.code, reason in answer.reason) == (code, True)
        if word == "drift":
            room.ready()
    room.console.request("no_teleop")
    room.ready()
    room.topics.tell_bridge("console/teleop/enabled", b"")
    assert room.try_to_arm().code == "other_owner", "what cannot be read may say so"
    assert room.verdict()["set_points"] == 0


# what goes wrong at the robot, and what is not as it should be


@pytest.mark.parametrize(
    ("word", "reason", "mode"),
    [
        ("fault", "an error was asked for|state is FAULT", RobotMode.FAULT),
        ("error", "an error was asked for|state is FAULT", RobotMode.FAULT),
        ("mute", "was not measured|does not follow", RobotMode.FAULT),
        ("stick", "does not follow", RobotMode.HOLDING),
        ("teleop", "teleoperation is on", RobotMode.DISABLED),
        ("narrow", "does not follow", RobotMode.HOLDING),
    ],
)
def test_what_goes_wrong_at_the_robot_stops_the_motion(room, word, reason, mode):
    room.starts_moving()
    room.console.request(word)
    event = held(room)
    assert re.search(reason, event.reason)
    room.until(lambda: room.state.mode is mode)
    verdict = room.verdict()
    assert verdict["unsafe"] == 0, verdict["sentences"]
    assert max(verdict["sent_ns"]) <= event.at_ns <= verdict["held_ns"]
    assert (room.try_to_arm().outcome is Outcome.REFUSED) is (mode is not RobotMode.HOLDING)


def test_a_console_that_was_not_ready_for_a_moment_between_two_turns_ends_the_motion(room):
    room.starts_moving()
    for word in ("PAUSED", "ENABLED"):
        says_state(room, word, True, False)
    assert held(room).code == "not_enabled"


def test_a_console_that_is_disabled_busy_has_another_tool_or_is_elsewhere_is_not_armed(room, caplog):
    caplog.set_level("INFO", "suturegrasp.robot_bridge.psm1")
    room.ready()
    arm, asks, tells = room.console._arm, room.console.request, room.topics.tell_bridge
    beside = room.backend.kinematics.forward(np.array((0.0, 0, 0.1, 0, 0, 0)))

    def tells_elsewhere():
        tells("PSM1/local/measured_cp", crtk.pose_command(beside, room.now_ns + 1))

    for happens, code, reason, is_over in (
        (lambda: says_state(room, "ENABLED", True, True), "other_owner", "busy with a motion that is not ours", None),
        (lambda: arm.command("disable"), "not_enabled", "DISABLED, not ENABLED", lambda: arm.command("enable")),
        (lambda: arm.command("pause"), "not_enabled", "PAUSED", lambda: arm.command("resume")),
        (lambda: setattr(arm, "is_homed", False), "not_homed", "", lambda: setattr(arm, "is_homed", True)),
        (lambda: asks("unreached"), "goal_not_reached", "", None),
        (lambda: asks("fault"), "error_state", "", lambda: arm.command("enable")),
        (tells_elsewhere, "other_pose", "another arm or tool", None),
        (lambda: asks("mute"), "stale_state", "", lambda: asks("speak")),
    ):
        happens()
        room.until(lambda code=code: room.try_to_arm().code == code)
        assert reason in room.events[-1].reason
        if is_over:
            is_over()
        says_state(room, arm.state, arm.is_homed, False)
        room.ready()
    room.tick()
    told = [record.getMessage() for record in caplog.records if record.name == "suturegrasp.robot_bridge.psm1"]
    assert any("PAUSED" in line for line in told)
    assert (told[-1], len(told) < 30) == ("the arm is ready", True), "not at every turn"
    tells("PSM1/tool_type", b"")
    answer = room.try_to_arm()
    assert (answer.code, "its tool is something not readable" in answer.reason) == ("wrong_tool", True)


@pytest.mark.slow
def test_a_person_may_change_an_arms_state_while_it_is_disarmed_and_nobody_else_has_it(room, monkeypatch):
    def change(word, **presence):
        told = presence or {"challenge_ns": room.state.challenge_ns, "pressed": True}
        return room.command(CHANGE_STATE, ChangeState(room.header(), "psm1", StateWord[word], **told))

    room.ready()
    arm = room.console._arm
    for word in ("RESUME", "ENABLE", "HOME"):
        assert change(word, challenge_ns=room.state.challenge_ns).code == "no_presence", word
        assert change(word, pressed=True).code == "round_trip", word
    assert "PAUSED" in change("RESUME").reason, "it is not paused"
    for word, state in (("PAUSE", "PAUSED"), ("RESUME", "ENABLED"), ("DISABLE", "DISABLED"), ("ENABLE", "ENABLED")):
        assert change(word).outcome is Outcome.ACCEPTED
        room.until(lambda word=word: room.events[-1:] and room.events[-1].plan_id == f"state {word.lower()}")
        assert (room.events[-1].kind, arm.state) == (ExecutionKind.FINISHED, state)
    room.bridge.configure(replace(room.bridge.config, ratio=0.3))
    assert change("HOME").outcome is Outcome.ACCEPTED
    assert (room.try_to_arm().code, arm._ratio) == ("busy", 0.3)
    room.until(lambda: not arm.is_homed and "not homed" in room.backend.state(room.now_ns).reason)
    assert room.try_to_arm().code == "busy"
    room.until(lambda: room.events[-1].plan_id == "state home")
    assert (room.events[-1].kind, arm.is_homed) == (ExecutionKind.FINISHED, True)
    room.ready()
    with monkeypatch.context() as patched:
        patched.setattr(arm, "command", lambda _word: None)
        patched.setattr("agents.robot_bridge.state_changes.LIMIT_S", 0.1)
        assert change("PAUSE").outcome is Outcome.ACCEPTED
        room.until(lambda: room.events[-1].code == "state_not_reached")
    room.topics.owner_changed(SOMEBODY, True)
    assert "somebody else" in change("HOME").reason
    room.topics.owner_changed(SOMEBODY, False)
    room.topics.tell_bridge("PSM1/free", crtk.empty())
    assert "somebody else has to do with it: PSM1/free" in change("HOME").reason
    room.starts_moving()
    assert change("HOME").code == "busy"
    assert arm.is_homed
    assert room.verdict()["unsafe"] == 0


def test_whoever_says_hold_has_a_console_that_homes_pause(room):
    room.ready()
    told = {"challenge_ns": room.state.challenge_ns, "pressed": True}
    assert room.command(CHANGE_STATE, ChangeState(room.header(), "psm1", StateWord.HOME, **told)).code == ""
    room.tick(20)
    assert room.command(HOLD, Hold(room.header(), "psm1")).code == ""
    room.tick(200)
    assert (room.console._arm.state, room.console._arm.is_homed) == ("PAUSED", False)
    # a console that goes on homing when it is resumed, or was told to home there, pauses too
    room.console._arm.command("resume")
    room.console._arm.command("home")
    room.until(lambda: room.backend._readings.busy)
    assert room.command(HOLD, Hold(room.header(), "psm1")).code == ""
    room.tick(200)
    assert (room.console._arm.state, room.console._arm.is_homed) == ("PAUSED", False)


def test_a_pause_that_did_not_get_through_is_said_again_though_nothing_was_heard_yet_of_what_homes(room, monkeypatch):
    room.ready()
    told = {"challenge_ns": room.state.challenge_ns, "pressed": True}
    assert room.command(CHANGE_STATE, ChangeState(room.header(), "psm1", StateWord.HOME, **told)).code == ""
    with monkeypatch.context() as down:
        down.setattr(Link, "say", lambda *_: False)
        assert "told again in each turn" in room.command(HOLD, Hold(room.header(), "psm1")).reason
    room.tick(200)
    assert (room.console._arm.state, room.console._arm.is_homed) == ("PAUSED", False)


@pytest.mark.parametrize("what", ["arm", "home"])
def test_what_was_asked_before_a_hold_and_is_taken_up_after_it_moves_nothing(room, what):
    room.ready()
    room.publish(room.plan())
    room.tick(4)
    heard_ns = room.state.challenge_ns
    room.tick(4)
    assert room.command(HOLD, Hold(room.header(), "psm1")).code == ""
    if what == "arm":
        answer = room.command(ARM, Arm(room.header(), "psm1", room.plan().plan_id, heard_ns, pressed=True))
    else:
        home = ChangeState(room.header(), "psm1", StateWord.HOME, heard_ns, pressed=True)
        answer = room.command(CHANGE_STATE, home)
    assert (answer.code, "somebody said hold since" in answer.reason) == ("hold_command", True)
    room.tick(40)
    assert not room.moves
    assert not room.backend._readings.busy


def test_a_hold_at_the_console_after_the_last_challenge_that_whoever_arms_had_heard_keeps_the_arm_where_it_is(room):
    room.ready()
    room.publish(room.plan())
    room.topics.tell_bridge("PSM1/hold", crtk.empty())
    answer = room.arm_again()
    assert (answer.code, "somebody said hold since" in answer.reason) == ("hold_command", True)
    room.tick(20)
    assert not room.moves
    assert room.try_to_arm().code == ""


def test_a_motion_begins_when_its_guard_lets_it_through_and_ends_where_that_never_does(room, monkeypatch):
    room.ready()
    before = room.verdict()["position"]
    monkeypatch.setattr(room.backend, "lets_through", lambda _arming: False)
    assert room.try_to_arm().code == ""
    assert held(room).code == "no_guard"
    assert np.abs(np.subtract(room.verdict()["position"], before)).max() < 1e-9


def test_a_dry_run_checks_all_of_a_motion_and_sends_nothing(room):
    room.backend.dry_run = True
    room.ready()
    answer = room.try_to_arm()
    assert (answer.code, "passes every check" in answer.reason) == ("dry_run", True)
    room.backend.move(np.zeros(6), 0.0, "a")
    assert "nothing was sent" in room.command(HOLD, Hold(room.header(), "psm1")).reason
    assert room.backend.change_state(StateWord.HOME, room.now_ns) == "nothing is sent in a dry run"
    room.tick(10)
    verdict = room.verdict()
    assert (verdict["set_points"], verdict["held_ns"]) == (0, 0)


# guard, link and person


def test_without_a_living_guard_a_real_arm_is_not_armed_and_does_not_go_on(room, monkeypatch):
    room.starts_moving()
    room.topics.guards.clear()
    monkeypatch.setattr(room.guard, "turn", lambda: None)
    sent = room.verdict()["set_points"]
    held(room)
    room.until(lambda: room.try_to_arm().code == "no_guard")
    assert "no guard stands by" in room.events[-1].reason
    assert room.verdict()["set_points"] == sent


def test_a_motion_ends_where_the_link_to_the_robot_broke_though_it_is_there_again_at_once(room):
    room.starts_moving()
    room.backend._link.broken += 1
    event = held(room)
    assert (event.code, "the link to the robot broke" in event.reason) == ("stale_state", True)


def test_a_process_that_beats_by_itself_arms_no_real_arm(room):
    room.ready()
    room.publish(room.plan())
    assert room.command(ARM, Arm(room.header(), "psm1", "p", room.state.challenge_ns)).code == "no_presence"
    assert room.try_to_arm().code == ""


def test_what_a_real_arm_needs_to_know_and_does_not_speaks_against_arming_with_what_to_do(room):
    room.ready()
    room.backend._has_no = frozenset()
    answer = room.try_to_arm()
    # the emulated console says whether its teleoperation is on, and where its endoscope is, and nobody pressed a pedal
    assert (answer.code, "press the clutch once" in answer.reason) == ("unknown", True)
    for word in ("clutch", "unclutch"):
        room.console.request(word)
    room.ready()
    assert room.try_to_arm().code == ""


def test_what_a_console_never_told_is_not_known_until_it_tells_it():
    heard = {}

    def linked(_settings, _naming, topics, *_rest) -> Any:
        heard.update({each.topic: each.receive for each in topics})
        return SimpleNamespace(failed="", broken=0, open=lambda: None, say=lambda *_: True)

    arm = DvrkPsm("PSM1", SessionSettings(), Ros2dds(), "", dry_run=False, linked=linked, clock=lambda: EPOCH_NS)
    topics = "footpedals/clutch", "ECM/local/measured_cp", "PSM1/measured_cp", "console/teleop/enabled"
    assert len(arm.state(EPOCH_NS).untold) == len(topics)
    # also what cannot be read has been told
    for told, topic in enumerate(topics, 1):
        heard[topic](b"", EPOCH_NS)
        assert len(arm.state(EPOCH_NS).untold) == len(topics) - told, topic


def test_challenges_come_often_while_a_plan_may_be_armed_so_that_the_way_of_an_answer_is_known(room):
    room.ready()
    room.tick(300)
    config = room.bridge.config
    assert room.bridge.tick_hz == config.resting_hz
    room.publish(room.plan())
    assert room.bridge.tick_hz == config.tick_hz
    room.tick(1, round(1e9 * config.maximum_plan_age_s))
    assert room.bridge.tick_hz == config.resting_hz


# stopping


def test_a_hold_that_could_not_be_handed_over_says_so_and_is_said_in_each_turn_until_the_arm_is_measured_to_stand(
    room, monkeypatch
):
    def holds(ticks, moved=0.0):
        """How many the console hears in so many turns, in each of which the arm moves by so much."""
        before = len(room.verdict()["holds_ns"])
        for _ in range(ticks):
            room.console.place(np.array(room.verdict()["position"][:6]) + moved)
            room.tick()
        return len(room.verdict()["holds_ns"]) - before

    room.ready()
    with monkeypatch.context() as down:
        down.setattr(Link, "say", lambda *_: False)
        answer = room.command(HOLD, Hold(room.header(), "psm1"))
        assert (answer.outcome, "told again in each turn" in answer.reason) == (Outcome.ACCEPTED, True)
        assert holds(5) == 0
    assert holds(50, moved=0.003) == 50, "it still moves"
    room.console.request("mute")
    assert holds(50) == 50, "where nothing is measured nobody knows that it stands"
    room.console.request("speak")
    assert 0 < holds(100) < 60
    assert holds(20) == 0, "it is known to stand"


def test_of_many_halts_at_once_the_console_hears_one(room):
    room.ready()
    for _ in range(600):
        room.bridge.halt()
    assert len(room.verdict()["holds_ns"]) == 1
    room.now_ns += SECOND_NS // 100
    room.bridge.halt()
    assert len(room.verdict()["holds_ns"]) == 2


def test_a_bridge_that_is_stopped_in_mid_motion_holds(room):
    room.starts_moving()
    room.bridge.close()
    assert room.verdict()["held_ns"] == room.now_ns
    assert room.verdict()["unsafe"] == 0


# time


def test_a_replayed_time_reaches_no_robot_and_no_replay_has_one(room):
    room.backend.state(room.now_ns - 3600 * SECOND_NS)
    room.backend.move(np.zeros(6), 0.0, "a")
    assert room.backend.state(0).readiness is Readiness.DISABLED
    verdict = room.verdict()
    assert (verdict["set_points"], verdict["held_ns"]) == (0, 0)
    # what stops is said whatever the time
    assert room.backend.hold()
    assert [room.backend.change_state(word, room.now_ns) for word in (StateWord.PAUSE, StateWord.DISABLE)] == ["", ""]
    assert (room.verdict()["held_ns"], room.verdict()["state"]) == (room.now_ns, "DISABLED")
    arm = {"backend": "dvrk", "T_camera_base": SIMULATED_T_CAMERA_BASE.tolist(), "dvrk": {"endpoint": "tcp/[::1]:7"}}
    bridge = build(with_simulated_arms(RigConfig.model_validate({"robot": {"psm1": arm}})), "robot_bridge", "psm1")
    assert isinstance(bridge, RobotBridge)
    assert isinstance(bridge._backend, SimulatedPsm)


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


# configuration


def test_the_example_with_an_emulated_arm_has_it_where_the_simulated_one_stands():
    arm = load_config(Path(__file__).parents[4] / "deploy" / "emulated.toml", RigConfig).robot["psm1"]
    assert arm.T_camera_base is not None
    assert np.abs(np.array(arm.T_camera_base) - SIMULATED_T_CAMERA_BASE).max() < 1e-8


def test_the_rigs_access_rules_allow_nothing_of_the_robots_keys():
    names = ["robot_bridge.psm1", "operator.desk", "planner.main", "viewer.desk"]
    allowed = [zenoh.KeyExpr(k) for rule in access_control("lab", names)["rules"] for k in rule["key_exprs"]]
    robots = ("PSM1/servo_jp", "guarded/PSM1/servo_jp", RmwZenoh().key("PSM1/servo_jp", JOINT_STATE))
    assert allowed
    assert not any(one.intersects(zenoh.KeyExpr(robot)) for one in allowed for robot in robots)
