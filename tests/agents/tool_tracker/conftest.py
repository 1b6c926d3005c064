"""A drawn instrument before a camera, its arm with a wrong registration, and who looks for it: agents in step."""

from typing import NamedTuple

import numpy as np
import pytest

from agents.camera.scene_source import calibration_of
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.correction import CorrectionLimits
from agents.robot_bridge.simulated import SimulatedPsm
from agents.tool_tracker.agent import ToolTracker
from agents.tool_tracker.correction import about
from schemas.messages import FrameStamp, ImageEncoding, RobotState, StereoFrame, ToolCorrection, ToolStatus
from schemas.topics import CALIBRATION, FRAMES, MAIN, ROBOT_STATE, TOOL
from shared.calibration.identity import calibration_id
from shared.images import encode_image
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T_TRUE
from shared.rigid_transforms import apply
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick
from shared.runtime.replay import Lockstep
from tests.rigs.drawn_tool import IN_MM, JAW, joints, pair_of

TIP = np.array([[0.0, 0.0, 0.0102]])
CALIBRATED = calibration_of(IN_MM)


class DrawnCamera(Agent):
    """Draws the arm's instrument where it really is, five times a second; `shown` False hides it."""

    kind, instance, tick_hz = "camera", MAIN, 5.0
    inputs = (Input(ROBOT_STATE, "psm1"),)
    outputs = (FRAMES, CALIBRATION)
    commands = ()

    def __init__(self) -> None:
        self.shown, self._state, self._sequence = True, None, 0

    def step(self, arrived: Received | Tick | Command):
        if isinstance(arrived, Received):
            self._state = arrived.message
        if not isinstance(arrived, Tick):
            return
        if self._sequence == 0:
            yield Output(CALIBRATION, CALIBRATED)
        self._sequence += 1
        if isinstance(self._state, RobotState):
            state = self._state
            images = pair_of(state.T_base_tool, state.jaw_rad, self._sequence, self.shown)
            left, right = (encode_image(one, ImageEncoding.RAW) for one in images)
            stamp = FrameStamp(self._sequence, arrived.now_ns, arrived.now_ns, calibration_id(CALIBRATED))
            yield Output(FRAMES, StereoFrame(stamp, left, right))


@pytest.fixture(scope="session")
def registered() -> np.ndarray:
    """Where the base is told to be: 8 mm and 3 degrees off, about the tip."""
    tip = apply(T_TRUE @ PSM.forward(joints(0)), TIP)[0]
    return about(tip, np.array((0.005, -0.004, 0.0048, 0.03, -0.03, 0.03))) @ T_TRUE


class Begun(NamedTuple):
    """Agents in step that have run until the instrument was followed, and what was told of it then."""

    session: Lockstep
    camera: DrawnCamera
    found: ToolCorrection


@pytest.fixture(scope="session")
def begun_session(registered: np.ndarray) -> Begun:
    """One for all tests, of which one alone goes on with it."""
    camera = DrawnCamera()
    config = RobotBridgeConfig(T_camera_base=registered, correction=CorrectionLimits())
    bridge = RobotBridge(config, SimulatedPsm(tuple(joints(0)), JAW))
    session = Lockstep(bridge, camera, ToolTracker(), rig="lab")
    for _ in range(30):
        session.run(0.1)
        told = session.last.get(TOOL)
        if told is not None and told.status is ToolStatus.CONVERGED:
            return Begun(session, camera, told)
    raise AssertionError(session.last[TOOL].reason)
