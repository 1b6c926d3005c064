"""An emulated console, heard and told through our own codec over a real router, by either codec."""

import contextlib
import json
import threading

import numpy as np
import pytest

from agents.dvrk_emulator.arm import EmulatedArm
from agents.dvrk_emulator.asked import answering
from agents.dvrk_emulator.console import Behaviour, EmulatedConsole
from agents.dvrk_emulator.geometry import LIMITS, tool
from agents.dvrk_emulator.oracle import Circumstances, Field, Oracle
from agents.dvrk_emulator.poses import joints_at
from agents.dvrk_emulator.wire import BridgeWire, RmwWire
from shared.kinematics.psm import forward
from shared.ros import crtk, types
from shared.ros.link import Heard, RosLink, Said
from shared.ros.naming import RmwZenoh, Ros2dds

ARM = "PSM1"
HEARS = {
    "measured_js": (types.JOINT_STATE, crtk.joints, False),
    "local/measured_cp": (types.POSE_STAMPED, crtk.pose, False),
    "operating_state": (types.OPERATING_STATE, crtk.operating_state, True),
    "tool_type": (types.STRING, crtk.text, True),
    "warning": (types.STRING, crtk.text, True),
}
SAYS = {
    "servo_jp": types.JOINT_STATE,
    "move_jp": types.JOINT_STATE,
    "servo_cp": types.POSE_STAMPED,
    "move_cp": types.POSE_STAMPED,
    "trajectory_j/set_ratio": types.FLOAT64,
    "hold": types.EMPTY,
    "state_command": types.STRING_STAMPED,
}


class Ours:
    """Our link to a console, and what that said last, by topic."""

    def __init__(self, settings, naming):
        self.last = {}
        heard = tuple(
            Heard(f"{ARM}/{topic}", of, lambda data, _, topic=topic, read=read: self._take(topic, read(data)), latched)
            for topic, (of, read, latched) in HEARS.items()
        )
        self.link = RosLink(settings, naming, heard, tuple(Said(f"{ARM}/{topic}", of) for topic, of in SAYS.items()))
        self.link.open()

    def _take(self, topic, value):
        self.last[topic] = value

    def say(self, topic, data):
        self.link.say(f"{ARM}/{topic}", data)

    @property
    def joints(self):
        return self.last["measured_js"].position

    @property
    def state(self):
        return self.last["operating_state"]


@pytest.fixture(params=["ros2dds", "rmw_zenoh"])
def console(request, session, settings):
    """An emulated console behind a router, and our link to it."""
    rmw, stopped = request.param == "rmw_zenoh", threading.Event()
    wire, naming = (RmwWire(session, 7), RmwZenoh(7)) if rmw else (BridgeWire(session), Ros2dds())
    with (
        contextlib.closing(EmulatedConsole(wire, ARM, Oracle(), Behaviour())) as emulated,
        contextlib.ExitStack() as up,
    ):
        up.enter_context(answering(session, emulated))
        running = threading.Thread(target=emulated.run, args=(stopped,))
        running.start()
        up.callback(lambda: (stopped.set(), running.join()))
        ours = Ours(settings, naming)
        up.callback(ours.link.close)
        yield emulated, ours


@pytest.mark.slow
def test_a_console_is_enabled_and_homed_moves_is_held_and_pauses(console, until):
    emulated, ours = console

    def near(joints, within=1e-9):
        return np.abs(emulated.verdict()["position"][:6] - joints).max() < within

    until(lambda: {"measured_js", "operating_state", "tool_type"} <= set(ours.last))
    assert ours.state == ("DISABLED", False, False)
    assert ours.last["tool_type"] == "LARGE_NEEDLE_DRIVER:400006"
    start = ours.joints
    goal = start + np.array((0.3, 0.1, 0.02, 1.0, 0.0, 0.0))
    ours.say("servo_jp", crtk.joint_command(goal, 0))
    until(lambda: "ignored" in ours.last.get("warning", ""))
    assert np.array_equal(ours.joints, start)
    assert emulated.verdict()["rules"] == {"state": 1, "speed": 1}

    ours.say("state_command", crtk.state_command("enable", 0))
    until(lambda: ours.state.state == "ENABLED")
    ours.say("state_command", crtk.state_command("home", 0))
    until(lambda: ours.state == ("ENABLED", True, False))
    ours.say("move_jp", crtk.joint_command(goal, 0))
    until(lambda: ours.state.is_busy)
    until(lambda: not np.array_equal(ours.joints, start))
    ours.say("hold", crtk.empty())
    until(lambda: not ours.state.is_busy)
    held = np.array(emulated.verdict()["position"][:6])
    share = (held - start)[:4] / (goal - start)[:4]
    assert share.min() > 0 and share.max() < 1 and np.ptp(share) < 1e-9, "a line in joint space, held on the way"
    ours.say("servo_jp", crtk.joint_command(held + np.array((9.0, 0, 0, 0, 0, 0)), 0))
    until(lambda: abs(ours.joints[0] - LIMITS[0, 1]) < 1e-9)
    until(lambda: np.abs(ours.last["local/measured_cp"].T - forward(ours.joints)).max() < 1e-9)

    # poses, at once and by a trajectory that is slowed down
    here = start + np.array((0.2, 0.1, 0, 0, 0, 0))
    emulated.place(here)
    beside = here + np.array((-0.002, 0.001, 0.0005, 0.01, 0.01, -0.01))
    ours.say("servo_cp", crtk.pose_command(forward(beside), 0))
    until(lambda: near(beside))
    ours.say("trajectory_j/set_ratio", crtk.ratio(0.02))
    ours.say("move_cp", crtk.pose_command(forward(start), 0))
    until(lambda: ours.state.is_busy and not near(beside, 1e-3))
    assert not near(start, 0.1), "at a fiftieth of its speed it takes half a minute"
    ours.say("trajectory_j/set_ratio", crtk.ratio(1.0))
    until(lambda: near(start))
    until(lambda: not ours.state.is_busy)
    assert emulated.verdict()["rules"] == {"state": 1, "limits": 1, "speed": 2}
    ours.say("state_command", crtk.state_command("pause", 0))
    until(lambda: ours.state.state == "PAUSED")


def test_only_what_somebody_subscribes_to_is_published(session, settings, until):
    # the last of Humble, whose keys have no hash
    for wire, naming in (
        (BridgeWire(session), Ros2dds()),
        (RmwWire(session, 0), RmwZenoh()),
        (RmwWire(session, 0, False), RmwZenoh(0, False)),
    ):
        outlet = wire.publish("PSM1/measured_js", "sensor_msgs::msg::dds_::JointState_", latched=False)
        assert not outlet.wanted()
        heard = Heard("PSM1/measured_js", types.JOINT_STATE, lambda _data, _ns: None)
        with contextlib.closing(RosLink(settings, naming, (heard,))) as link:
            link.open()
            until(outlet.wanted)
        until(lambda wanted=outlet.wanted: not wanted())
        wire.close()


def test_two_ways_of_computing_where_joints_lead_agree_and_joints_of_a_pose_are_found_again():
    joints = LIMITS[:, 0] + np.random.default_rng(5).random((200, 6)) * np.diff(LIMITS, axis=1)[:, 0]
    for (R, p), T in zip((tool(q) for q in joints), forward(joints), strict=True):
        np.testing.assert_allclose(np.column_stack((R, p)), T[:3], atol=1e-12)
    joints[:, 2] = 0.06 + 0.9 * (joints[:, 2] - 0.06).clip(0)
    np.testing.assert_allclose([joints_at(*tool(q), q) for q in joints], joints, atol=1e-9)
    assert np.isnan(joints_at(np.full((3, 3), np.nan), np.zeros(3), joints[0])).all()


def test_joints_with_a_lag_come_that_much_behind_a_steady_motion_and_stand_where_they_should():
    arm, speed, period_s = EmulatedArm(ready=True, warn=lambda _: None, lag_s=0.04), 0.2, 0.005
    start = arm.position.copy()
    for turn in range(1, 201):
        arm.head("arm", start[:6] + np.eye(6)[0] * speed * turn * period_s, moving=False)
        arm.step(period_s)
    behind_s = (start[0] + speed * 200 * period_s - arm.position[0]) / speed
    assert 0.03 < behind_s < 0.05
    for _ in range(200):
        arm.step(period_s)
    assert abs(arm.position[0] - start[0] - speed) < 1e-4


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
def test_fingers_that_touch_stay_there_press_the_more_they_are_told_beyond_and_arrive(lag_s):
    arm = EmulatedArm(True, lambda _: None, lag_s=lag_s, jaw_stop_rad=0.1)
    efforts = []
    for told in (0.4, 0.05, -0.2):
        assert arm.head("jaw", np.array([told]), moving=True)
        assert arm.is_busy
        for _ in range(400):
            arm.step(0.005)
        assert not arm.is_busy
        assert arm.position[6] == pytest.approx(max(told, 0.1), abs=1e-3)
        efforts.append(arm.jaw_effort)
    assert efforts[0] == 0 > efforts[1] > efforts[2]
    arm.hold()
    arm.step(0.005)
    assert arm.jaw_effort == 0


def test_somebody_at_the_console_closes_the_jaw_until_a_set_point_or_a_hold_comes():
    arm = EmulatedArm(True, lambda _: None)
    arm.jaw_by_hand(0.5)
    arm.step(0.1)
    assert 0 < arm.goal[6] < 0.5
    arm.step(1.0)
    assert arm.goal[6] == pytest.approx(0.5)
    arm.jaw_by_hand(-0.3)
    arm.hold()
    arm.step(1.0)
    assert arm.goal[6] == pytest.approx(arm.position[6])


BASE = np.array([[-1.0, 0, 0, 0.045], [0, 1, 0, 0.01], [0, 0, -1, -0.05], [0, 0, 0, 1]])
START = np.array((0.0, 0.0, 0.12, 0.0, 0.0, 0.0))
AT = np.append(START, 0.0)


@pytest.mark.parametrize(
    ("rule", "changes"),
    [
        ("", {}),
        ("state", {"arm": Circumstances(AT, takes_commands=False)}),
        ("nobody", {"now_s": 1.5}),
        ("values", {"values": START[:5]}),
        ("values", {"values": START + np.nan}),
        ("limits", {"values": START + np.array((0, 0, 0, 0, 1.4, 0))}),
        ("remote centre", {"values": START - np.array((0, 0, 0.06, 0, 0, 0))}),
        ("workspace", {"values": START + np.array((0, 0, 0.1, 0, 0, 0))}),
        ("mixed", {"arm": Circumstances(AT, mixed=True)}),
        ("speed", {"arm": Circumstances(AT + 0.1, held=True)}),
        ("speed", {"values": START + np.array((0.1, 0, 0, 0, 0, 0))}),
    ],
)
def test_the_oracle_finds_what_is_unsafe_and_nothing_else(rule, changes):
    oracle = Oracle(Field(BASE), hears_heartbeats=True)
    oracle.heartbeat(1.0)
    oracle.judge("arm", START, 1.0, Circumstances(AT))
    values, now_s = changes.get("values", START), changes.get("now_s", 1.01)
    oracle.judge("arm", values, now_s, changes.get("arm", Circumstances(AT)))
    found = oracle.verdict()
    assert found["set_points"] == 2
    assert rule in found["rules"] if rule else not found["rules"]
    json.dumps(found)


def test_a_heartbeat_that_comes_just_after_the_set_points_that_it_allowed_is_in_time():
    oracle = Oracle(hears_heartbeats=True)
    for now_s in (1.0, 5.0):
        oracle.judge("arm", START, now_s, Circumstances(AT))
    assert oracle.verdict()["rules"] == {"nobody": 2}
    oracle.heartbeat(5.1)
    assert oracle.verdict()["rules"] == {"nobody": 1}
