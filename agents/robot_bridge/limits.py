"""How fast, where and how long an arm may move, and where it stands."""

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.jaw import UNCALIBRATED, Jaw
from schemas.messages import TissueSurface
from schemas.topics import THREAD
from shared.kinematics.arm import ArmKinematics

MAXIMUM_PLAN_AGE_S = 30.0
"""Since the frame that a plan was made from was captured, unless a rig says otherwise: docs/decisions.md, 9."""


PSM_JOINT_SPEEDS = (1.0, 1.0, 0.08, 8.0, 3.0, 8.0)
"""Of a PSM's joints, rad/s and m/s: a quarter more than the limits of speed below ask of them anywhere in the workspace
from an insertion of 50 mm on, the inverse of the Jacobian says; a tenth to two thirds of what the joints could."""


def _before_the_camera() -> Float64[np.ndarray, "2 3"]:
    return np.array(((-0.08, -0.06, 0.02), (0.08, 0.06, 0.13)))


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """What a motion must keep to. SI units.

    Fields:
        rounding_s: over how long a bend is rounded, at full speed (path.py).
        contact_share: the share of full speed while there may be thread between the fingers.
        pull_share: the same while closed jaws pull thread: 5 mm/s, so that what runs through tissue within the oldest
            tail that may be pulled by (1 s) is no more than one segment (pull_segment_m of the planner).
        joint_share: the share of the joints' greatest speeds, so that an arm has some left to catch up with, and its
            guard some to spare.
        joint_speeds: those that count, where they are less than the arm's own; None for the arm's own.
        dexterity: the least that an arm's kinematics may tell of a pose, 0 being a singular one.
        press_m: how far behind the tissue's measured surface a finger may come, beyond what is uncertain of it: as far
            as a planner may be told to press (docs/planner.md).
        workspace_camera: the lower and the upper corner of the box that the pin of the jaw must stay in.
        maximum_duration_s: of one checked segment of a motion, whatever the speed.
    """

    speed: float = 0.05
    acceleration: float = 0.2
    jerk: float = 4.0
    angular_speed: float = 1.5
    angular_acceleration: float = 6.0
    angular_jerk: float = 120.0
    jaw_speed: float = 2.0
    jaw_acceleration: float = 16.0
    jaw_jerk: float = 320.0
    rounding_s: float = 0.1
    contact_share: float = 0.4
    pull_share: float = 0.1
    joint_share: float = 0.8
    joint_speeds: tuple[float, ...] | None = None
    dexterity: float = 0.3
    press_m: float = 0.01
    workspace_camera: Float64[np.ndarray, "2 3"] = field(default_factory=_before_the_camera)
    maximum_duration_s: float = 60.0

    def slowed(self, share: float) -> "MotionLimits":
        """The same at a share of full speed, so that all of a motion takes 1 / share as long, within the same cap."""
        return dataclasses.replace(
            self,
            speed=self.speed * share,
            acceleration=self.acceleration * share**2,
            jerk=self.jerk * share**3,
            angular_speed=self.angular_speed * share,
            angular_acceleration=self.angular_acceleration * share**2,
            angular_jerk=self.angular_jerk * share**3,
            jaw_speed=self.jaw_speed * share,
            jaw_acceleration=self.jaw_acceleration * share**2,
            jaw_jerk=self.jaw_jerk * share**3,
            rounding_s=self.rounding_s / share,
            joint_share=self.joint_share * share,
        )


@dataclass(frozen=True)
class PullLimits:
    """The most that a pull may be armed for, and how old the newest tail may be while the jaws pull."""

    length_m: float = 0.3
    time_s: float = 600.0
    radius_m: float = 0.1
    tail_age_s: float = 1e-3 * (THREAD.maximum_age_ms or 1e3)


@dataclass(frozen=True, eq=False)
class Setup:
    """An arm, where its base is, what it must keep to, and the time between two of its set points.

    Fields:
        surface: the tissue as it was measured last; None where it was not, or too long ago.
        jaw: how its jaw is told a plan's angles.
    """

    kinematics: ArmKinematics
    T_camera_base: Float64[np.ndarray, "4 4"]
    limits: MotionLimits
    period_s: float
    surface: TissueSurface | None = None
    jaw: Jaw = UNCALIBRATED
