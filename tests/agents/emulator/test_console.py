"""An emulated console, heard and told through our own codec over a real router, by either codec."""

import contextlib
import json
import threading

import numpy as np
import pytest

from agents.emulator.arm import EmulatedArm
from agents.emulator.asked import answering
from agents.emulator.console import Behaviour, EmulatedConsole
from agents.emulator.geometry import LIMITS, tool
from agents.emulator.oracle import Circumstances, Field, Oracle
from agents.emulator.poses import joints_at
from agents.emulator.wire import BridgeWire, RmwWire
from shared.clock import monotonic_s
from shared.kinematics.psm import forward
from shared.ros import crtk, types
from shared.ros.link import Heard, RosLink, Said
from shared.ros.naming import RmwZenoh, Ros2dds
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session

DEADLINE_S = 20.0
ARM = "PSM1"


def until(condition):
    """Wait for a condition, with a deadline."""
    deadline_s, turn = monotonic_s() + DEADLINE_S, threading.Event()
    while not condition():
        assert monotonic_s() < deadline_s, "it never came true"
        turn.wait(0.01)


class Ears:
    """What is heard, by topic."""

    def __init__(self):
        self.heard = {}

    def of(self, topic, ros_type, read, latched=False):
        def receive(data, _):
            self.heard[topic] = [*self.heard.get(topic, ()), read(data)]

        return Heard(f"{ARM}/{topic}", ros_type, receive, latched)

    def last(self, topic):
        return self.heard.get(topic, [None])[-1]


@pytest.fixture(params=["ros2dds", "rmw_zenoh"])
def console(request):
    """An emulated console behind a router, our link to it, and what that heard."""
    endpoint, ears, stopped = free_local_endpoint(), Ears(), threading.Event()
    heard = (
        ears.of("measured_js", types.JOINT_STATE, crtk.joints),
        ears.of("local/measured_cp", types.POSE_STAMPED, crtk.pose),
        ears.of("operating_state", types.OPERATING_STATE, crtk.operating_state, latched=True),
        ears.of("tool_type", types.STRING, crtk.text, latched=True),
        ears.of("warning", types.STRING, crtk.text, latched=True),
    )
    said = (
        Said(f"{ARM}/servo_jp", types.JOINT_STATE),
        Said(f"{ARM}/move_jp", types.JOINT_STATE),
        Said(f"{ARM}/servo_cp", types.POSE_STAMPED),
        Said(f"{ARM}/move_cp", types.POSE_STAMPED),
        Said(f"{ARM}/trajectory_j/set_ratio", types.FLOAT64),
        Said(f"{ARM}/hold", types.EMPTY),
        Said(f"{ARM}/state_command", types.STRING_STAMPED),
    )
    rmw = request.param == "rmw_zenoh"
    with contextlib.ExitStack() as stack:
        stack.enter_context(open_router(endpoint))
        session = stack.enter_context(open_session(SessionSettings(endpoint=endpoint)))
        wire = RmwWire(session, 7) if rmw else BridgeWire(session)
        emulated = stack.enter_context(contextlib.closing(EmulatedConsole(wire, ARM, Oracle(), Behaviour())))
        stack.enter_context(answering(session, emulated))
        running = threading.Thread(target=emulated.run, args=(stopped,))
        running.start()
        stack.callback(lambda: (stopped.set(), running.join()))
        naming = RmwZenoh(7) if rmw else Ros2dds()
        link = stack.enter_context(contextlib.closing(RosLink(SessionSettings(endpoint=endpoint), naming, heard, said)))
        link.open()
        yield emulated, link, ears


def command(link, word):
    at = types.message("std_msgs/msg/Header", types.message("builtin_interfaces/msg/Time", 0, 0), "")
    link.say(f"{ARM}/state_command", types.encode(types.STRING_STAMPED, types.message(types.STRING_STAMPED, at, word)))


@pytest.mark.slow
def test_a_console_is_enabled_and_homed_moves_is_held_and_pauses(console):
    emulated, link, ears = console
    until(lambda: ears.last("measured_js") and ears.last("operating_state") and ears.last("tool_type"))
    assert ears.last("operating_state") == ("DISABLED", False, False)
    assert ears.last("tool_type") == "LARGE_NEEDLE_DRIVER:400006"
    start = ears.last("measured_js").position
    goal = start + np.array((0.3, 0.1, 0.02, 1.0, 0.0, 0.0))
    link.say(f"{ARM}/servo_jp", crtk.joint_command(goal, 0))
    until(lambda: "ignored" in (ears.last("warning") or ""))
    assert np.array_equal(ears.last("measured_js").position, start)
    assert emulated.verdict()["rules"] == {"state": 1, "speed": 1}

    command(link, "enable")
    until(lambda: ears.last("operating_state").state == "ENABLED")
    command(link, "home")
    until(lambda: ears.last("operating_state") == ("ENABLED", True, False))
    link.say(f"{ARM}/move_jp", crtk.joint_command(goal, 0))
    until(lambda: ears.last("operating_state").is_busy)
    until(lambda: not np.array_equal(ears.last("measured_js").position, start))
    link.say(f"{ARM}/hold", crtk.empty())
    until(lambda: not ears.last("operating_state").is_busy)
    held = np.array(emulated.verdict()["position"][:6])
    share = (held - start)[:4] / (goal - start)[:4]
    assert share.min() > 0 and share.max() < 1 and np.ptp(share) < 1e-9, "a line in joint space, held on the way"
    link.say(f"{ARM}/servo_jp", crtk.joint_command(held + np.array((9.0, 0, 0, 0, 0, 0)), 0))
    until(lambda: abs(ears.last("measured_js").position[0] - LIMITS[0, 1]) < 1e-9)
    until(lambda: np.abs(ears.last("local/measured_cp").T - forward(ears.last("measured_js").position)).max() < 1e-9)
    assert emulated.verdict()["rules"] == {"state": 1, "limits": 1, "speed": 2}

    # poses, at once and by a trajectory that is slowed down
    here = start + np.array((0.2, 0.1, 0, 0, 0, 0))
    emulated.place(here)
    near = here + np.array((-0.002, 0.001, 0.0005, 0.01, 0.01, -0.01))
    link.say(f"{ARM}/servo_cp", crtk.pose_command(forward(near), 0))
    until(lambda: np.abs(emulated.verdict()["position"][:6] - near).max() < 1e-9)
    link.say(f"{ARM}/trajectory_j/set_ratio", crtk.ratio(0.02))
    link.say(f"{ARM}/move_cp", crtk.pose_command(forward(start), 0))
    until(lambda: ears.last("operating_state").is_busy and emulated.verdict()["position"][0] < near[0] - 1e-3)
    assert emulated.verdict()["position"][0] - start[0] > 0.1, "at a fiftieth of its speed it takes half a minute"
    link.say(f"{ARM}/trajectory_j/set_ratio", crtk.ratio(1.0))
    until(lambda: np.abs(emulated.verdict()["position"][:6] - start).max() < 1e-9)
    until(lambda: not ears.last("operating_state").is_busy)
    assert emulated.verdict()["rules"] == {"state": 1, "limits": 1, "speed": 2}

    command(link, "pause")
    until(lambda: ears.last("operating_state").state == "PAUSED")


def test_only_what_somebody_subscribes_to_is_published():
    endpoint = free_local_endpoint()
    with open_router(endpoint), open_session(SessionSettings(endpoint=endpoint)) as session:
        wires = (
            (BridgeWire(session), Ros2dds()),
            (RmwWire(session, 0), RmwZenoh()),
            # of Humble, whose keys have no hash
            (RmwWire(session, 0, False), RmwZenoh(0, False)),
        )
        for wire, naming in wires:
            outlet = wire.publish("PSM1/measured_js", "sensor_msgs::msg::dds_::JointState_", latched=False)
            assert not outlet.wanted()
            heard = Heard("PSM1/measured_js", types.JOINT_STATE, lambda _data, _ns: None)
            with contextlib.closing(RosLink(SessionSettings(endpoint=endpoint), naming, (heard,))) as link:
                link.open()
                until(outlet.wanted)
            until(lambda wanted=outlet.wanted: not wanted())
            wire.close()


def anywhere(count, seed):
    """Joints, drawn evenly within their limits."""
    return LIMITS[:, 0] + np.random.default_rng(seed).random((count, 6)) * np.diff(LIMITS, axis=1)[:, 0]


def test_two_ways_of_computing_where_joints_lead_agree():
    joints = anywhere(200, 5)
    for (R, p), T in zip((tool(q) for q in joints), forward(joints), strict=True):
        np.testing.assert_allclose(np.column_stack((R, p)), T[:3], atol=1e-12)


def test_joints_of_a_pose_are_found_again():
    joints = anywhere(100, 6)
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


def test_an_arm_that_is_stuck_or_at_fault_stays_where_it_is():
    arm = EmulatedArm(ready=True, warn=lambda _: None)
    assert arm.head("arm", START, moving=False)
    arm.stuck = True
    assert not arm.step(0.1)
    arm.stuck = False
    assert arm.step(0.1)
    arm.fail()
    assert not arm.step(0.1)
    assert not arm.head("arm", START, moving=False)
