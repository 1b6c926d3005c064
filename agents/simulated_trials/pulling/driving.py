"""Who decides on a pull, and who moves the arm for it.

A `Puller` looks at reconstructed threads and says what to do next. A `Driver` moves an arm and hands it what is seen: a
planner and a robot bridge in step are one; `Stepwise` makes one of a puller and an arm without dynamics. SI units.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from agents.simulated_trials.look import Look
from agents.simulated_trials.table import SpeedLimits
from schemas.messages import ThreadReconstruction
from shared.rigid_transforms import angle_between, transform

SIGMAS_95 = 1.959963984540054


@dataclass(frozen=True)
class ArmState:
    """An arm as measured; `moves` while it carries out a segment."""

    T_camera_tool: Float64[np.ndarray, "4 4"]
    jaw_rad: float
    moves: bool = False


@dataclass(frozen=True)
class Measured:
    """How long the tail is, with its standard deviation; at least so long where its end is not seen."""

    tail_m: float
    deviation_m: float
    at_least: bool = False

    def covers(self, tail_m: float) -> bool:
        """Whether the 95 % interval has that length in it."""
        off = SIGMAS_95 * self.deviation_m
        return tail_m >= self.tail_m - off and (self.at_least or tail_m <= self.tail_m + off)


@dataclass(frozen=True)
class Waypoint:
    """A pose of the tool and the opening of its jaw; `in_contact`: thread may be between the fingers on the way."""

    T_camera_tool: Float64[np.ndarray, "4 4"]
    jaw_rad: float
    in_contact: bool = True


@dataclass(frozen=True)
class Segment:
    """What an arm that stands is to do next."""

    waypoints: tuple[Waypoint, ...]


@dataclass(frozen=True)
class Stop:
    """The pull is over: `reached` where the tail is said to have the asked length; why, in a word and in words."""

    reached: bool
    code: str
    sentence: str
    measured: Measured | None = None


@dataclass(frozen=True)
class Said:
    """What a puller says of one frame: the tail in it, and what to do, which only an arm that stands begins with."""

    measured: Measured | None
    then: Segment | Stop | None = None


@dataclass(frozen=True)
class Task:
    """What a driver is asked for, and told.

    Fields:
        goal_m: how long the tail is to be.
        exit_px: a rectified left-image pixel (u, v) at the tail's hole, as somebody points at it.
        T_camera_base: where the arm stands, as registered.
        tool_error_m, hand_eye_m: deviation of each axis of the tool tip, and the most of the registration's shift.
    """

    goal_m: float
    exit_px: Float64[np.ndarray, "2"]
    T_camera_base: Float64[np.ndarray, "4 4"]
    tool_error_m: float
    hand_eye_m: float


class Puller(Protocol):
    """Decides on a pull, frame by frame."""

    def seen(self, thread: ThreadReconstruction, arm: ArmState, goal_m: float) -> Said:
        """What to do when a thread was seen, and the arm is there now."""
        ...


class Driver(Protocol):
    """Moves an arm until the pull is over."""

    @property
    def began_ns(self) -> int:
        """When the trial began, by the clock that frames are to be stamped with."""
        ...

    def advance(self, elapsed_s: float) -> ArmState:
        """Let so much time pass; the arm as measured then."""
        ...

    def see(self, look: Look) -> Measured | None:
        """Take what was seen in a frame; the tail in it."""
        ...

    @property
    def ended(self) -> Stop | None:
        """How the pull ended, None while it has not."""
        ...


class Stepwise:
    """A puller with an arm that goes from waypoint to waypoint, at its greatest speed, evenly."""

    began_ns = 0

    def __init__(self, puller: Puller, goal_m: float, arm: ArmState, limits: SpeedLimits) -> None:
        self._puller, self._goal_m, self._limits = puller, goal_m, limits
        self._arm = arm
        self._way: list[Waypoint] = []
        self.ended: Stop | None = None

    def advance(self, elapsed_s: float) -> ArmState:
        """Go on along the segment."""
        while self._way and elapsed_s > 0.0:
            to = self._way[0]
            needs_s = _least_s(self._arm, to, self._limits)
            self._arm = _towards(self._arm, to, 1.0 if needs_s <= elapsed_s else elapsed_s / needs_s)
            if needs_s <= elapsed_s:
                self._way.pop(0)
            elapsed_s -= needs_s
        return ArmState(self._arm.T_camera_tool, self._arm.jaw_rad, bool(self._way))

    def see(self, look: Look) -> Measured | None:
        """Ask the puller."""
        arm = self.advance(0.0)
        said = self._puller.seen(look.thread, arm, self._goal_m)
        if isinstance(said.then, Stop):
            self.ended, self._way = said.then, []
        elif said.then is not None and not arm.moves:
            self._way = list(said.then.waypoints)
        return said.measured


def _least_s(arm: ArmState, to: Waypoint, limits: SpeedLimits) -> float:
    distance = float(np.linalg.norm(to.T_camera_tool[:3, 3] - arm.T_camera_tool[:3, 3]))
    turn = float(angle_between(arm.T_camera_tool[None, :3, :3], to.T_camera_tool[None, :3, :3])[0])
    slowest = max(
        distance / limits.speed, turn / limits.angular_speed, abs(to.jaw_rad - arm.jaw_rad) / limits.jaw_speed
    )
    return slowest / (limits.contact_share if to.in_contact else 1.0)


def _towards(arm: ArmState, to: Waypoint, share: float) -> ArmState:
    a, b = arm.T_camera_tool, to.T_camera_tool
    turn = Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()
    R = Rotation.from_rotvec(share * turn).as_matrix() @ a[:3, :3]
    place = a[:3, 3] + share * (b[:3, 3] - a[:3, 3])
    return ArmState(transform(R, place), arm.jaw_rad + share * (to.jaw_rad - arm.jaw_rad))


def covered(told: Sequence[tuple[Measured, float]]) -> int:
    """How many of the intervals have the true length beside them in them."""
    return sum(measured.covers(tail_m) for measured, tail_m in told)
