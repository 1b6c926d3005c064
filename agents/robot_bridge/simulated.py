"""A simulated PSM: the real kinematics and speed limits, without inertia, gravity or anything to touch."""

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.backend import ArmState
from schemas.messages import StateWord
from shared.kinematics.arm import ArmKinematics
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE

__all__ = ["SIMULATED_START", "SIMULATED_T_CAMERA_BASE", "SimulatedPsm"]

SIMULATED_START = (0.18, 0.04, 0.132, 0.0, 0.0, 0.0)
"""Joints of psm1 where it waits beside the field of view, its tool straight."""


def waiting(T_camera_base: Float64[np.ndarray, "4 4"]) -> tuple[float, ...]:
    """Joints of an arm that waits on its own side of the field of view: those of psm1, or their mirror image."""
    yaw, *others = SIMULATED_START
    return (yaw if T_camera_base[0, 3] >= 0 else -yaw, *others)


class SimulatedPsm:
    """An arm that goes towards its set point as fast as its joints may, and stands still without one.

    Time passes for it when its state is asked for, so it may be that of a recording.
    """

    accepts_replayed_time = True
    dry_run = False
    is_real = False

    def __init__(
        self,
        joints: tuple[float, ...] = SIMULATED_START,
        jaw_rad: float = 0.0,
        kinematics: ArmKinematics = LARGE_NEEDLE_DRIVER,
    ) -> None:
        """Stand at these joints."""
        self.kinematics = kinematics
        self._limits = np.vstack((kinematics.limits, kinematics.jaw_limit))
        self._max_speeds = np.append(kinematics.max_speeds, kinematics.jaw_max_speed)
        self._position = np.append(np.array(joints), jaw_rad)
        self._set_point = self._position
        self._now_ns: int | None = None

    def state(self, now_ns: int) -> ArmState:
        """Where the arm is after going on until now."""
        elapsed_s = 0.0 if self._now_ns is None else max(now_ns - self._now_ns, 0) * 1e-9
        self._now_ns = now_ns
        if self._position is not self._set_point:
            reach = self._max_speeds * elapsed_s
            self._position = self._position + np.clip(self._set_point - self._position, -reach, reach)
        return ArmState(now_ns, self._position[:6], float(self._position[6]))

    def move(self, joints: Float64[np.ndarray, "6"], jaw_rad: float, arming_id: str) -> None:  # noqa: ARG002
        """Head for these joints, clipped to their limits as the robot clips them."""
        self._set_point = np.clip(np.append(joints, jaw_rad), self._limits[:, 0], self._limits[:, 1])

    def lets_through(self, arming_id: str) -> bool:  # noqa: ARG002
        """Always: nothing is between."""
        return True

    def finish(self, arming_id: str) -> None:
        """It rests where it was sent."""

    def hold(self) -> bool:
        """Head for nowhere."""
        self._set_point = self._position
        return True

    def halt(self) -> None:
        """Nothing: it moves from step to step alone, and the command is the next one."""

    @property
    def halted(self) -> bool:
        """Never."""
        return False

    def rearm(self, asked_ns: int) -> bool:  # noqa: ARG002
        """Always: nobody but the bridge holds it."""
        return True

    @property
    def holds(self) -> bool:
        """It does at once."""
        return self._set_point is self._position

    def change_state(self, word: StateWord, now_ns: int) -> str:  # noqa: ARG002
        """It has no states but one."""
        return "a simulated arm is always enabled and homed"

    def reached_state(self, word: StateWord) -> bool:  # noqa: ARG002
        """It has states of its own from the beginning."""
        return True

    def slow_down(self, ratio: float) -> None:
        """It makes no motion by itself."""

    def close(self) -> None:
        """Stay."""
        self.hold()
