"""Arms without a robot behind them: the simulated PSM, and any other that a file alone describes."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.launch.other_arms import other_arms
from agents.robot_bridge.limits import MotionLimits
from agents.robot_bridge.simulated import SIMULATED_START, SimulatedPsm, waiting
from schemas.messages import ExecutionKind, Phase, Waypoint
from shared.kinematics.dh_file import read_dh
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER, Problem, forward, joint_problem
from shared.kinematics.simulated_setup import SIMULATED_BASES, SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import exp_so3, inverse, transform
from shared.runtime.config import ConfigError
from tests.agents.robot_bridge.drive import SECOND, Drive, plan

START = np.array(SIMULATED_START)
FILE = Path(__file__).parents[3] / "deploy" / "generic_arm.toml"


def test_each_arm_waits_on_its_own_side_beside_the_field_of_view_and_before_the_camera() -> None:
    assert joint_problem(START) == Problem.NONE
    right, up, away = (SIMULATED_T_CAMERA_BASE @ forward(START))[:3, 3]
    assert 0.02 < away < 0.07
    assert right / away > 0.48
    assert waiting(SIMULATED_T_CAMERA_BASE) == SIMULATED_START
    base = SIMULATED_BASES["psm2"]
    left = (base @ forward(np.array(waiting(base))))[:3, 3]
    np.testing.assert_allclose(left, (-right, up, away), atol=1e-12)


def test_no_joint_of_a_simulated_arm_is_faster_than_it_can_be_it_arrives_and_set_points_are_clipped() -> None:
    arm = SimulatedPsm()
    state = arm.state(0)
    target = np.array((-0.5, 0.4, 0.2, 3.0, -1.0, 9.0))
    arm.move(target, 9.0, "a")
    for tick in range(1, 101):
        before, state = state.joints, arm.state(tick * SECOND // 100)
        assert (np.abs(state.joints - before) * 100 <= LARGE_NEEDLE_DRIVER.max_speeds * (1 + 1e-9)).all()
    np.testing.assert_allclose(state.joints, (*target[:5], LARGE_NEEDLE_DRIVER.limits[5, 1]))
    assert state.jaw_rad == LARGE_NEEDLE_DRIVER.jaw_limit[1]


def test_a_simulated_arm_stands_still_without_a_set_point_where_the_clock_goes_back_and_at_once_on_hold() -> None:
    arm = SimulatedPsm()
    arm.state(SECOND)
    arm.state(2 * SECOND)
    arm.move(START + 0.1, 1.0, "a")
    np.testing.assert_array_equal(arm.state(0).joints, START)
    stopped = arm.state(SECOND // 1000)
    assert not np.array_equal(stopped.joints, START)
    assert not arm.holds
    arm.hold()
    after = arm.state(SECOND)
    np.testing.assert_array_equal(after.joints, stopped.joints)
    assert (after.jaw_rad, arm.holds) == (stopped.jaw_rad, True)


# an arm that is no PSM, from a file


def pose(x_mm: float, y_mm: float, z_mm: float, turn: float) -> np.ndarray:
    return transform(exp_so3(np.array((0.1, 0.0, turn))), np.array((x_mm, y_mm, z_mm)) / 1e3)


def bridge(**changes: Any) -> Any:
    """Its tool looks into the camera's field at first."""
    told = tomllib.loads(FILE.read_text())
    T_camera_base = pose(20, 5, 60, 0.2) @ inverse(read_dh(told).forward(np.array(told["start"])))
    arm = {"kinematics": str(FILE), "T_camera_base": T_camera_base.tolist()} | changes
    return build(RigConfig.model_validate({"robot": {"psm1": arm}}), "robot_bridge", "psm1")


def test_another_arm_carries_out_a_plan_from_its_table() -> None:
    slide = [Waypoint(pose(x, 6, 75, 0.3 + 0.02 * x), 0.3, Phase.SLIDE, None) for x in range(10)]
    approach = Waypoint(pose(0, 6, 70, 0.3), 0.8, Phase.APPROACH, None)
    grasp = Waypoint(slide[-1].T_camera_tool, -0.2, Phase.GRASP, None)
    drive = Drive(make=lambda *_: bridge()).armed(plan(waypoints=(approach, *slide, grasp))).run(2000)
    assert drive.events[-1].kind is ExecutionKind.FINISHED, drive.events[-1].reason
    end = drive.states[-1]
    assert end.kinematics == "dh"
    joints = np.stack([state.joints for state in drive.states])
    assert np.abs(np.diff(joints, axis=0)).max() < 0.05, "it keeps to its posture"
    assert not read_dh(tomllib.loads(FILE.read_text())).problems(joints).any()
    reached = end.T_camera_base @ end.T_base_tool
    turned = [np.abs(reached @ np.diag((s, s, 1.0, 1.0)) - grasp.T_camera_tool).max() for s in (1.0, -1.0)]
    assert min(turned) < 1e-6
    places = np.stack([state.T_base_tool[:3, 3] for state in drive.states])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= 1.001 * MotionLimits().speed * 0.01


def test_the_planner_is_told_the_geometry_where_the_file_is(tmp_path: Path) -> None:
    files = {"psm1": FILE, "psm2": tmp_path / "arm.toml"}
    arms = {
        arm: {"kinematics": str(file), "T_camera_base": transform(np.eye(3), np.full(3, 0.1 * i)).tolist()}
        for i, (arm, file) in enumerate(files.items())
    }
    desk = {"address": "10.0.0.1", "runs": ["planner", "operator", "robot_bridge psm1"]}
    robot = {"address": "10.0.0.2", "runs": ["robot_bridge psm2"]}
    hosts = {"hosts": {"desk": desk, "robot": robot}, "router": {"host": "desk"}, "host": "desk", "security": {}}
    told = other_arms(RigConfig.model_validate({"robot": arms, "planner": {}, **hosts}))
    assert {name: one.name for name, one in told.items()} == {"psm1": "dh"}


def test_a_file_that_is_no_arm_and_one_without_a_place_are_refused(tmp_path: Path) -> None:
    nothing = tmp_path / "arm.toml"
    nothing.write_text("joints = []")
    with pytest.raises(ConfigError, match=r"arm\.toml describes no arm"):
        bridge(kinematics=str(nothing))
    with pytest.raises(ValueError, match="needs T_camera_base"):
        bridge(T_camera_base=None)
