"""Where registration and joints have an arm's tool at the time of a frame, from states before and after it."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo, RobotState
from schemas.topics import ROBOT_STATE
from shared.rigid_transforms import exp_se3, inverse, log_se3

APART_NS = 60_000_000
"""A state that was measured so far from a frame's time tells nothing of it by itself."""
BRACKET_NS = round(1.5e9 / (ROBOT_STATE.resting_hz or 10.0))
"""Two states around a frame tell it where they are no farther apart than those of an arm at rest, one late."""


class Placed(NamedTuple):
    """`T_camera_base` as registered, `T_base_tool` and the jaw's angle at a time, and when that was measured."""

    measured_ns: int
    T_camera_base: Float64[np.ndarray, "4 4"]
    T_base_tool: Float64[np.ndarray, "4 4"]
    jaw_rad: float

    @property
    def place(self) -> tuple[Float64[np.ndarray, "4 4"], Float64[np.ndarray, "4 4"], float]:
        """Without the time."""
        return self.T_camera_base, self.T_base_tool, self.jaw_rad


def placed_at(states: Sequence[RobotState], at_ns: int) -> Placed | None:
    """The place at a time, between the states around it; None where none was measured near it."""
    nearest = min(states, key=lambda state: abs(state.measured_ns - at_ns))
    before = max((s for s in states if s.measured_ns <= at_ns), key=lambda s: s.measured_ns, default=None)
    after = min((s for s in states if s.measured_ns > at_ns), key=lambda s: s.measured_ns, default=None)
    if before is not None and after is not None and after.measured_ns - before.measured_ns <= BRACKET_NS:
        share = (at_ns - before.measured_ns) / (after.measured_ns - before.measured_ns)
        T = before.T_base_tool @ exp_se3(share * log_se3(inverse(before.T_base_tool) @ after.T_base_tool))
        jaw = (1 - share) * before.jaw_rad + share * after.jaw_rad
        return Placed(nearest.measured_ns, registered(after), T, jaw)
    if abs(nearest.measured_ns - at_ns) > APART_NS:
        return None
    return Placed(nearest.measured_ns, registered(nearest), nearest.T_base_tool, nearest.jaw_rad)


def registered(state: RobotState) -> Float64[np.ndarray, "4 4"]:
    """Where the base is registered, whatever the bridge makes of it."""
    if state.T_camera_base_registered is not None:
        return state.T_camera_base_registered
    return state.T_camera_base


def in_metres(camera: RectifiedStereo) -> RectifiedStereo:
    """The same camera with its baseline in metres."""
    return dataclasses.replace(camera, baseline=camera.baseline * (camera.metres_per_unit or 1.0), metres_per_unit=1.0)
