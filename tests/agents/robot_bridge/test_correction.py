"""A base that the images correct: what speaks against a motion with it, before it begins and while it lasts."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.correction import FRESH_S, HELD_S, CorrectionLimits
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import (
    Arm,
    CommandAnswer,
    CommandHeader,
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    Outcome,
    Phase,
    Policy,
    RobotState,
    Status,
    ToolCandidate,
    ToolCorrection,
    ToolStatus,
    Waypoint,
)
from schemas.topics import ARM, EXECUTION, HEARTBEAT, PLAN, ROBOT_STATE, TOOL
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import exp_so3, transform
from shared.runtime.agent import Command, Output, Received, Tick

SECOND, TICK = 10**9, 10**7
EPOCH = 1_700_000_000 * SECOND
TURNED = exp_so3(np.array((0.1, 0, 0.3)))


class Rig:
    """A bridge that is fed by hand, whose base is corrected by the images."""

    def __init__(self) -> None:
        self.backend = SimulatedPsm()
        self.bridge = RobotBridge(RobotBridgeConfig(correction=CorrectionLimits()), self.backend)
        self.now_ns = EPOCH
        self.states, self.events = list[RobotState](), list[ExecutionEvent]()
        self.tick()

    def feed(self, arrived: Received | Tick | Command) -> list[Output | CommandAnswer]:
        said = list(self.bridge.step(arrived))
        for one in said:
            if isinstance(one, Output):
                (self.states if one.topic is ROBOT_STATE else self.events).append(one.message)
                assert one.topic in (ROBOT_STATE, EXECUTION)
        return said

    def tick(self, count: int = 1, elapsed_ns: int = TICK) -> None:
        for _ in range(count):
            self.now_ns += elapsed_ns
            self.feed(Received(HEARTBEAT, "", 0, Heartbeat("psm1", "p", self.now_ns, "a")))
            self.feed(Tick(self.now_ns))

    def look(self, age_s: float = 0.1, off_mm: float = 5.0, **changes: Any) -> None:
        """Perception tells that the tool is so far off, by a frame of so long ago."""
        self.feed(Received(TOOL, "", 0, looked(self.now_ns - round(age_s * SECOND), off_mm, **changes)))
        self.tick()

    def arm(self) -> CommandAnswer:
        places = ((15, 5, 60), (15, 5, 75), (20, 6, 65))
        waypoints = tuple(
            Waypoint(transform(TURNED, np.array(place) / 1e3), 0.5, Phase.APPROACH, None) for place in places
        )
        stamp = FrameStamp(1, self.now_ns, self.now_ns, "c")
        rest = (Status.OK, "", Policy.DIRECT, 0.5, 0.4, 0.9, 0.0, waypoints, ())
        self.feed(Received(PLAN, "", 0, GraspPlan("p", "psm1", "g", stamp, *rest)))
        message = Arm(CommandHeader("a", self.now_ns + SECOND, "ann"), "psm1", "p")
        answer = self.feed(Command(ARM, "psm1", message, self.now_ns))[0]
        assert isinstance(answer, CommandAnswer)
        return answer

    def moving(self) -> "Rig":
        """In mid-motion, with a look of now."""
        self.look()
        assert self.arm().outcome is Outcome.ACCEPTED
        self.tick(60)
        self.look()
        assert self.bridge.executes
        return self

    def held(self) -> tuple[str, str]:
        """The code and the reason of the hold that has come, after which nothing moves."""
        assert (self.events[-1].kind, self.bridge.executes) == (ExecutionKind.HELD, False)
        at = self.backend.state(self.now_ns).joints
        self.tick(20)
        np.testing.assert_array_equal(self.backend.state(self.now_ns).joints, at)
        return self.events[-1].code, self.events[-1].reason


def looked(captured_ns: int, off_mm: float, turned_deg: float = 0.0, **changes: Any) -> ToolCorrection:
    tip = np.array((0.01, 0.0, 0.06))
    corrected = tip + np.array((1e-3 * off_mm, 0.0, 0.0))
    R = exp_so3(np.radians((0.0, 0.0, turned_deg)))
    none = np.zeros((0, 2))
    found = ToolCandidate(np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 90, 0.9, 0.8, 0.5)
    told = ToolCorrection(
        arm="psm1",
        stamp=FrameStamp(1, captured_ns, captured_ns, "c"),
        measured_ns=captured_ns,
        status=ToolStatus.CONVERGED,
        reason="",
        T_correction=transform(R, corrected - R @ tip),
        pivot_camera=tip,
        tip_camera=corrected,
        tip_off_m=1e-3 * off_mm,
        turned_rad=float(np.radians(turned_deg)),
        tip_deviation_m=0.0005,
        turn_deviation_rad=0.01,
        registered_left_px=none,
        found_left_px=none,
        found_right_px=none,
        candidates=(found,),
        attempts=0,
        misses=0,
        looks=1,
    )
    return dataclasses.replace(told, **changes)


LOST: dict[str, Any] = {
    "status": ToolStatus.LOST,
    "reason": "it is not in view",
    "T_correction": None,
    "candidates": (),
}
MISSED: dict[str, Any] = {"misses": 1, "reason": "not seen", "T_correction": None}


@pytest.mark.parametrize(
    ("look", "code", "told"),
    [
        (None, "correction_lost", "nothing was told yet"),
        (LOST, "correction_lost", "it is not in view"),
        ({"tip_deviation_m": 0.002}, "correction_lost", "known to 2.0 mm only, where 1.5 mm are needed"),
        ({"off_mm": 16.0}, "correction_limit", "16.0 mm and 0.0 degrees off in the images, where 15 mm and 8 degrees"),
        ({"turned_deg": 9.0}, "correction_limit", "5.0 mm and 9.0 degrees off"),
        ({"age_s": HELD_S + 0.5}, "correction_lost", "seen 4.5 s ago in the images, and 4 s are allowed"),
        ({"age_s": -0.7}, "clock", "captured 0.7 s in the future: set the clocks"),
    ],
)
def test_nothing_is_armed_where_the_images_do_not_tell_where_the_tool_is(look, code, told):
    rig = Rig()
    if look is not None:
        rig.look(**look)
    rig.tick(elapsed_ns=TICK // 100)
    answer = rig.arm()
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, code)
    assert told in answer.reason


@pytest.mark.parametrize(
    ("look", "code", "told"),
    [
        ({"off_mm": 9.0}, "correction_jumped", "4.0 mm and 0.0 degrees from where it was when its motion was planned"),
        ({"turned_deg": 4.0}, "correction_jumped", "4.0 degrees from where it was"),
        ({"off_mm": 20.0}, "correction_limit", "register anew"),
        ({"tip_deviation_m": 0.002}, "correction_lost", "known to 2.0 mm only"),
        (LOST, "correction_lost", "not followed in the images any more: it is not in view"),
        ({"age_s": -0.7}, "clock", "in the future"),
    ],
)
def test_a_motion_ends_where_the_images_tell_something_else_or_nothing_any_more(look, code, told):
    rig = Rig().moving()
    rig.look(**look)
    assert rig.held()[0] == code
    assert told in rig.events[-1].reason


def test_a_look_that_came_late_is_held_said_so_and_given_up():
    """At load a look is told seconds after its frame; perception then falls silent in mid-motion."""
    rig = Rig()
    rig.bridge.configure(dataclasses.replace(rig.bridge.config, ratio=0.2))
    rig.tick(100)
    looked_ns = rig.now_ns
    rig.tick(250)
    rig.look(age_s=2.5)
    rig.tick(10)
    assert rig.states[-1].correction_looked_ns == looked_ns
    assert rig.states[-1].T_camera_base_registered is not None
    assert rig.arm().outcome is Outcome.ACCEPTED, "it has stood since"
    rig.tick(130)
    assert rig.bridge.executes
    assert rig.states[-1].correction_looked_ns == looked_ns
    # one more view in which it was not seen is no reason yet, and no look either
    rig.look(**MISSED)
    rig.tick(15)
    code, why = rig.held()
    assert code == "correction_lost"
    assert "4.0 s ago" in why


def test_an_arm_that_moved_since_it_was_seen_is_seen_again_first():
    rig = Rig()
    rig.look()
    state = rig.backend.state(rig.now_ns)
    rig.backend.move(state.joints + 0.01, state.jaw_rad, "a")
    rig.tick(50)
    assert rig.arm().outcome is Outcome.ACCEPTED, f"within {FRESH_S:g} s"
    rig = Rig()
    rig.look()
    rig.backend.move(state.joints + 0.01, state.jaw_rad, "a")
    rig.tick(150)
    answer = rig.arm()
    assert (answer.code, "has moved since" in answer.reason) == ("correction_lost", True)
    rig.look(age_s=1.2)
    assert rig.arm().outcome is Outcome.ACCEPTED


def test_a_tool_that_was_seen_before_camera_or_arm_were_moved_by_hand_is_seen_again_first():
    rig = Rig()
    rig.look()
    measured = rig.backend.state
    moved_ns = rig.now_ns
    rig.backend.state = lambda now_ns: dataclasses.replace(measured(now_ns), still_since_ns=moved_ns)
    rig.tick(5)
    answer = rig.arm()
    assert (answer.code, "moved by hand since the tool was seen" in answer.reason) == ("correction_lost", True)
    rig.tick(20)
    rig.look()
    assert rig.arm().outcome is Outcome.ACCEPTED


def test_a_plan_in_another_cameras_frame_than_the_look_at_the_tool_is_refused():
    rig = Rig()
    rig.look(stamp=FrameStamp(1, rig.now_ns, rig.now_ns, "other"))
    answer = rig.arm()
    assert (answer.code, "and the tool was seen in that of other" in answer.reason) == ("wrong_frame", True)


def test_a_base_that_nothing_corrects_says_so():
    rig = Rig()
    rig.tick(10)
    assert (rig.states[-1].correction_looked_ns, rig.states[-1].T_camera_base_registered) == (0, None)
    np.testing.assert_array_equal(rig.states[-1].T_camera_base, SIMULATED_T_CAMERA_BASE)
