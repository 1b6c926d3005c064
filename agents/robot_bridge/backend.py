"""What drives an arm: the seam between the bridge and a robot, simulated or real."""

import enum
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.refusals import Code
from schemas.messages import StateWord
from shared.kinematics.arm import ArmKinematics


class Readiness(enum.Enum):
    """Whether an arm would follow set points."""

    READY = 1
    DISABLED = 2
    FAULT = 3


@dataclass(frozen=True)
class ArmState:
    """An arm as measured.

    Fields:
        measured_ns: when, on the bridge's clock.
        reason, code: why it is not ready; empty where it is.
        busy: it makes a motion of its own.
        still_since_ns: what a camera saw before is elsewhere now: camera, set-up joints or the arm were moved.
        T_camera_base: where its base is now; None where that is as configured.
    """

    measured_ns: int
    joints: Float64[np.ndarray, "6"]
    jaw_rad: float
    readiness: Readiness = Readiness.READY
    reason: str = ""
    code: Code = Code.NOT_READY
    busy: bool = False
    still_since_ns: int = 0
    T_camera_base: Float64[np.ndarray, "4 4"] | None = None


class Backend(Protocol):
    """An arm. Its methods return at once, and what cannot be had shows in the state, not as an exception.

    Fields:
        kinematics: the arm's geometry and limits.
        accepts_replayed_time: whether the arm may live in the time of a recording that is replayed, as a simulated one
            may; an arm that is real may not, and does not move meanwhile.
        dry_run: nothing is sent, so that arming ends with what would be.
    """

    kinematics: ArmKinematics
    accepts_replayed_time: bool = False
    dry_run: bool = False

    def state(self, now_ns: int) -> ArmState:
        """The newest state; asked for once in every tick, before anything else."""
        ...

    def move(self, joints: Float64[np.ndarray, "6"], jaw_rad: float) -> None:
        """Take a new set point, a tick's way from the measured one."""
        ...

    def hold(self) -> None:
        """Stop where the arm is, and stay there."""
        ...

    def change_state(self, word: StateWord, now_ns: int) -> str:
        """Have the arm change its state, as a person wants it, while it is disarmed; why not, or empty."""
        ...

    def reached_state(self, word: StateWord) -> bool:
        """Whether the state that this leads to has come about since `change_state`, and the arm makes no motion."""
        ...

    def slow_down(self, ratio: float) -> None:
        """Have motions that the arm makes by itself, such as homing, take this share of their speed."""
        ...

    def close(self) -> None:
        """Stop where the arm is, if it was moved, and let go of it; nothing follows."""
        ...
