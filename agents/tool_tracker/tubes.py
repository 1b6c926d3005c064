"""An instrument as tubes along lines: shaft, wrist and two fingers, in metres and the camera's frame.

Shapes: the Large Needle Driver's (shared/kinematics/psm.py).

Where registration and joints have them at the time of a frame follows from states before and after it.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo, RobotState
from schemas.topics import ROBOT_STATE
from shared.kinematics.psm import FINGER_M, WRIST_M, shaft_and_pin
from shared.rigid_transforms import exp_se3, inverse, log_se3

SHAFT, WRIST, FINGER = range(3)


@dataclass(frozen=True)
class Shape:
    """Half-axes of an instrument's parts, metres; `shaft_m` is how much of the shaft is looked at."""

    shaft_radius: float = 0.0042
    shaft_m: float = 0.07
    finger_half_width: float = 0.0019
    finger_half_thickness: float = 0.00085


DRIVER = Shape()
"""The Large Needle Driver."""


@dataclass(frozen=True, eq=False)
class Tube:
    """A part: places along its axis, its two half-axes there, and the directions that these have."""

    part: int
    places: Float64[np.ndarray, "k 3"]
    wide: Float64[np.ndarray, "k"]
    thick: Float64[np.ndarray, "k"]
    wide_way: Float64[np.ndarray, "3"]
    thick_way: Float64[np.ndarray, "3"]

    def moved(self, T: Float64[np.ndarray, "4 4"]) -> "Tube":
        """The same elsewhere."""
        R = T[:3, :3]
        places = self.places @ R.T + T[:3, 3]
        return Tube(self.part, places, self.wide, self.thick, R @ self.wide_way, R @ self.thick_way)


def tubes(
    T_camera_base: Float64[np.ndarray, "4 4"],
    T_base_tool: Float64[np.ndarray, "4 4"],
    jaw_rad: float,
    shape: Shape = DRIVER,
) -> tuple[Tube, ...]:
    """The parts in the camera's frame: shaft, wrist, and two fingers that open by half the jaw's angle about x."""
    R, t = T_camera_base[:3, :3], T_camera_base[:3, 3]
    end, pin = (R @ p + t for p in shaft_and_pin(T_base_tool))
    x_tool, z_tool = R @ T_base_tool[:3, 0], R @ T_base_tool[:3, 2]
    u = end - t
    u = u / np.linalg.norm(u)
    aside = np.cross(u, x_tool)
    aside /= np.linalg.norm(aside)
    s = np.arange(0.0005, shape.shaft_m, 0.002)
    round_shaft = np.full(len(s), shape.shaft_radius)
    x = (pin - end) / np.linalg.norm(pin - end)
    k = np.linspace(0.1, 0.95, 9)
    size = shape.shaft_radius * np.interp(k, (0.0, 0.3, 1.0), (0.93, 0.8, 0.7))
    found = [
        Tube(SHAFT, end - s[:, None] * u, round_shaft, round_shaft, aside, np.cross(u, aside)),
        Tube(WRIST, end + WRIST_M * k[:, None] * x, size, size, x_tool, np.cross(x, x_tool)),
    ]
    f = np.linspace(0.35, 0.97, 10)
    taper = np.sqrt(1 - f**8) * (1 - 0.5 * f)
    for side in (-1.0, 1.0):
        half = 0.5 * jaw_rad * side
        along = np.cos(half) * z_tool - np.sin(half) * np.cross(x_tool, z_tool)
        across = np.cross(x_tool, along)
        centre = (
            pin + FINGER_M * f[:, None] * along - (side * 0.9 * shape.finger_half_thickness * taper)[:, None] * across
        )
        wide, thick = shape.finger_half_width * taper, shape.finger_half_thickness * taper
        found.append(Tube(FINGER, centre, wide, thick, x_tool, across))
    return tuple(found)


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
