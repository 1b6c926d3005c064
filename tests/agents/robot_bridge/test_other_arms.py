"""The seam holds: an arm that is no PSM carries out the same plan by the same bridge, from a file alone."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.cli.rig.builders import build
from agents.cli.rig.config import RigConfig
from agents.cli.rig.other_arms import other_arms
from agents.robot_bridge.agent import RobotBridge
from agents.robot_bridge.limits import MotionLimits
from schemas.messages import (
    Arm,
    CommandHeader,
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    Phase,
    Policy,
    RobotState,
    Status,
    Waypoint,
)
from schemas.topics import ARM, EXECUTION, HEARTBEAT, PLAN, ROBOT_STATE
from shared.kinematics.dh_file import read_dh
from shared.rigid_transforms import exp_so3, inverse, transform
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.config import ConfigError

FILE = Path(__file__).parents[3] / "deploy" / "generic_arm.toml"
TOLD = tomllib.loads(FILE.read_text())
KINEMATICS, START = read_dh(TOLD), np.array(TOLD["start"])
EPOCH, TICK = 1_700_000_000 * 10**9, 10**7


def pose(x_mm: float, y_mm: float, z_mm: float, turn: float) -> np.ndarray:
    return transform(exp_so3(np.array((0.1, 0.0, turn))), np.array((x_mm, y_mm, z_mm)) / 1e3)


def bridge(**changes: Any) -> RobotBridge:
    """Its tool looks into the camera's field at first."""
    T_camera_base = pose(20, 5, 60, 0.2) @ inverse(KINEMATICS.forward(START))
    arm = {"kinematics": str(FILE), "T_camera_base": T_camera_base.tolist()} | changes
    built = build(RigConfig.model_validate({"robot": {"psm1": arm}}), "robot_bridge", "psm1")
    assert isinstance(built, RobotBridge)
    return built


def test_another_arm_carries_out_a_plan_from_its_table() -> None:
    slide = [Waypoint(pose(x, 6, 75, 0.3 + 0.02 * x), 0.3, Phase.SLIDE, None) for x in range(10)]
    waypoints = (
        Waypoint(pose(0, 6, 70, 0.3), 0.8, Phase.APPROACH, None),
        *slide,
        Waypoint(slide[-1].T_camera_tool, -0.2, Phase.GRASP, None),
    )
    stamp = FrameStamp(1, EPOCH, EPOCH, "c")
    rest: dict[str, Any] = {"policy": Policy.DIRECT, "s_goal": 0.5, "s_capture": 0.5, "probability": 0.9}
    rest |= {"status": Status.OK, "reason": "", "slide_m": 0.0, "alternatives": ()}
    plan = GraspPlan(plan_id="p", arm="psm1", goal_id="g", stamp=stamp, waypoints=waypoints, **rest)
    driven, now_ns, said = bridge(), EPOCH, list[Output]()
    said += [o for o in driven.step(Tick(now_ns)) if isinstance(o, Output)]
    list(driven.step(Received(PLAN, "", 0, plan)))
    armed = list(driven.step(Command(ARM, "psm1", Arm(CommandHeader("a", now_ns + 10**9, "x"), "psm1", "p"), now_ns)))
    said += [o for o in armed if isinstance(o, Output)]
    for _ in range(2000):
        now_ns += TICK
        list(driven.step(Received(HEARTBEAT, "", 0, Heartbeat("psm1", "p", now_ns, "a"))))
        said += [o for o in driven.step(Tick(now_ns)) if isinstance(o, Output)]
        if not driven.executes:
            break
    events = [o.message for o in said if o.topic is EXECUTION]
    assert isinstance(events[-1], ExecutionEvent)
    assert events[-1].kind is ExecutionKind.FINISHED, events[-1].reason
    states = [o.message for o in said if o.topic is ROBOT_STATE]
    assert isinstance(states[-1], RobotState)
    assert states[-1].kinematics == "dh"
    joints = np.stack([state.joints for state in states])
    assert np.abs(np.diff(joints, axis=0)).max() < 0.05, "it keeps to its posture"
    assert not KINEMATICS.problems(joints).any()
    end = states[-1].T_camera_base @ states[-1].T_base_tool
    turned = [np.abs(end @ np.diag((s, s, 1.0, 1.0)) - waypoints[-1].T_camera_tool).max() for s in (1.0, -1.0)]
    assert min(turned) < 1e-6
    places = np.stack([state.T_base_tool[:3, 3] for state in states])
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
