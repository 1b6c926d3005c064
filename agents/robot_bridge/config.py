"""What a robot bridge is told: one arm, and how it is driven."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.correction import CorrectionLimits
from agents.robot_bridge.limits import MAXIMUM_PLAN_AGE_S, MotionLimits, PullLimits
from schemas.checks import MessageError
from schemas.messages.grasping import check_pose
from schemas.topics import ROBOT_STATE
from shared.calibration.jaw.file import JawZero
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.runtime.parameters import Between, settable


class RobotBridgeError(ValueError):
    """A configuration that no arm can be driven with; the text names the setting."""


@dataclass(frozen=True, eq=False)
class RobotBridgeConfig:
    """One arm and how it is driven.

    Fields:
        arm: its name, which is the instance in its keys.
        T_camera_base: where its base is, in the rectified left camera's frame, metres.
        dead_man_s: without a heartbeat for longer than this, the arm holds and is disarmed.
        first_heartbeat_s: how long the first one may take; nothing moves before it.
        maximum_frame_age_s: a motion holds where the newest camera frame is older.
        maximum_motion_s: the longest that one checked segment may last, whatever the speed; a longer motion is a chain.
        segment_drift_m: how far the first place of contact may be from where it was armed, in a chain's next segment.
        pull: the most that a pull may be armed for.
        registered_ns, registration_days: when the base was registered, and how long that holds; 0 where nobody says.
        tissue_needed: a real arm moves only where the tissue was measured.
        maximum_plan_age_s: since the frame that the plan was made from was captured; while the arm runs it can only be
            made smaller than it was configured.
        ratio: of the speed that a motion was planned with; a motion that is under way goes over to another smoothly.
        tick_hz, resting_hz: turns a second while the arm is armed or moves, and while it is disarmed and still; each
            turn of a motion sends a set point.
        calibration_id: of the camera calibration in whose rectified frame the base is told; empty where nobody says.
        correction: how far perception may correct where the base is, by its tool in the images; None where it may not.
        jaw_zero, jaw_days: where the jaw of its instrument closes, None where nobody calibrated that; for how long.
    """

    arm: str = "psm1"
    T_camera_base: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: SIMULATED_T_CAMERA_BASE)
    dead_man_s: float = 0.2
    first_heartbeat_s: float = 1.0
    maximum_plan_age_s: float = settable(MAXIMUM_PLAN_AGE_S, Between(0.1))
    maximum_frame_age_s: float = settable(0.5, Between(0.1))
    maximum_motion_s: float = 60.0
    segment_drift_m: float = 0.01
    pull: PullLimits = field(default_factory=PullLimits)
    registered_ns: int = 0
    registration_days: float = 30.0
    tissue_needed: bool = True
    ratio: float = settable(1.0, Between(0.05, 1.0))
    tick_hz: float = ROBOT_STATE.rate_hz or 100.0
    resting_hz: float = ROBOT_STATE.resting_hz or 10.0
    limits: MotionLimits = field(default_factory=MotionLimits)
    correction: CorrectionLimits | None = None
    calibration_id: str = ""
    jaw_zero: JawZero | None = None
    jaw_days: float = 30.0

    def __post_init__(self) -> None:
        try:
            check_pose("the arm's T_camera_base", self.T_camera_base)
        except MessageError as error:
            raise RobotBridgeError(str(error)) from error
        seconds = ("dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "maximum_frame_age_s", "maximum_motion_s")
        for name in (*seconds, "ratio", "tick_hz", "resting_hz", "registration_days", "jaw_days"):
            if not 0 < getattr(self, name) < float("inf"):
                raise RobotBridgeError(f"{name} must be positive and finite, not {getattr(self, name)}")
        if self.ratio > 1:
            raise RobotBridgeError(f"ratio must not be above 1, and is {self.ratio}")
