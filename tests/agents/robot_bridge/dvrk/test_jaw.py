"""An emulated instrument that does not close at 0: what the console tells is recorded, and a grasp closes by it."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from agents.cli.calibrate.jaw import instrument_of, motion_of
from agents.robot_bridge.limits import MotionLimits
from schemas.codec import decode, encode
from schemas.messages import ExecutionKind, GraspPlan, Phase, RobotMode, RobotState
from shared.calibration.jaw.estimate import estimated
from shared.calibration.jaw.file import JawZero, jaw_zero_of, jaw_zero_text, read_jaw_zero
from tests.agents.robot_bridge.drive import SHORT_GRASP, plan, waypoint
from tests.agents.robot_bridge.dvrk.conftest import Room
from tests.rigs.robot.world import HZ, TICK_NS, TOOL

CLOSES_RAD = -0.15
"""At 0 its tips are 1.5 mm apart."""
CLOSED_AT_0 = (
    *SHORT_GRASP[:-1],
    dataclasses.replace(SHORT_GRASP[-1], jaw_rad=0.0),
    waypoint((32, 8.5, 70), 0.0, Phase.RETREAT, 0.5),
)


class Instrumented(Room):
    """A room whose plans close the jaw at 0."""

    def __init__(self, **jaw: Any) -> None:
        super().__init__(MotionLimits(), **jaw)

    def plan(self) -> GraspPlan:
        return plan("p", stamp=self.stamp(), waypoints=CLOSED_AT_0, depth_m=0.002)


def closed_by_hand(room: Room, times: int) -> list[RobotState]:
    """All states of an arm, as they are recorded, whose jaw somebody at the console closes so often."""
    told = list[RobotState]()
    for word in ("open_jaw", "close_jaw") * times:
        room.console.request(word)
        for _ in range(round(2.0 * HZ / 2)):
            room.tick(elapsed_ns=2 * TICK_NS)
            if room.state is not None and (not told or room.state is not told[-1]):
                told.append(decode(RobotState, encode(room.state)))
    return told


def found_by(room: Room, path: Path) -> JawZero:
    """As `calibrate jaw` finds it, out of its file."""
    states = closed_by_hand(room, 3)
    zero = jaw_zero_of(estimated(motion_of(states)), "psm1", instrument_of(states, ""), states[-1].measured_ns)
    path.write_text(jaw_zero_text(zero))
    return read_jaw_zero(path)


def test_from_closings_by_the_console_to_a_grasp_that_closes(tmp_path: Path) -> None:
    lag_s = 0.04
    zero = found_by(Instrumented(lag_s=lag_s, jaw_stop_rad=CLOSES_RAD), tmp_path / "jaw.json")
    assert (zero.closes_rad, zero.told_rad) == pytest.approx((CLOSES_RAD, CLOSES_RAD), abs=5e-3)
    assert (zero.arm, zero.instrument, zero.closings) == ("psm1", TOOL, 3)
    room = Instrumented(lag_s=lag_s, jaw_stop_rad=CLOSES_RAD, jaw_zero=zero)
    room.starts_moving()
    room.until(lambda: not room.moves)
    assert room.events[-1].kind is ExecutionKind.FINISHED, room.events[-1].reason
    room.tick(4)
    verdict = room.verdict()
    assert verdict["unsafe"] == 0, verdict["sentences"]
    # it is measured where its fingers touch, presses on beyond, and is told to be closed
    assert verdict["position"][6] == pytest.approx(CLOSES_RAD)
    assert verdict["goal"][6] < CLOSES_RAD - 0.01
    assert room.state is not None
    assert room.state.jaw_effort is not None and room.state.jaw_effort < 0
    assert room.state.jaw_rad == pytest.approx(0.0, abs=3e-3)


def test_while_somebody_closes_the_jaw_nothing_is_said_to_the_arm() -> None:
    room = Instrumented(jaw_stop_rad=CLOSES_RAD)
    states = closed_by_hand(room, 1)
    assert room.verdict()["set_points"] == 0
    assert room.verdict()["held_ns"] == 0
    assert {state.mode for state in states} <= {RobotMode.DISABLED, RobotMode.IDLE}


def test_a_grasp_whose_jaw_is_kept_open_is_held_at_the_console() -> None:
    zero = JawZero("psm1", TOOL, CLOSES_RAD, CLOSES_RAD, 0.004, 5, Room().now_ns)
    # something of 2 mm is between its fingers
    room = Instrumented(jaw_stop_rad=CLOSES_RAD + 0.2, jaw_zero=zero)
    room.starts_moving()
    room.until(lambda: not room.moves)
    assert (room.events[-1].kind, room.events[-1].code) == (ExecutionKind.HELD, "jaw_open")
    room.until(lambda: room.verdict()["held_ns"] > 0)
    assert room.verdict()["unsafe"] == 0
