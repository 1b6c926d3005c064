"""What the kinematics of an arm with six joints and a jaw must tell: the seam between bridge and geometry.

The tool frame sits on the pin of the jaw, z along the closed fingers, x the axis about which they open; the base frame
is the arm's own. Joints are in radians, or in metres where they slide. Any number of poses at once.
"""

import enum
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float64, Int64

JOINTS = 6


class Problem(enum.IntEnum):
    """Why a pose, or a set of joints, is not for an arm. Every value above NONE is a fault; the last six are joints."""

    NONE = 0
    NOT_FINITE = 1
    NO_ROTATION = 2
    WRIST_FOLDED = 3
    REMOTE_CENTRE = 4
    YAW = 5
    PITCH = 6
    INSERTION = 7
    ROLL = 8
    WRIST_PITCH = 9
    WRIST_YAW = 10


class Link(NamedTuple):
    """One row of a Denavit-Hartenberg table; the joint's own value is added to θ, or to d where it slides."""

    alpha: float
    a: float
    theta: float
    d: float
    slides: bool
    limit: tuple[float, float]
    max_speed: float


class Solution(NamedTuple):
    """Joints that bring the tool to a pose, and the Problem that forbids them; NaN where there are none at all."""

    joints: Float64[np.ndarray, "*batch 6"]
    problem: Int64[np.ndarray, "*batch"]


class ArmKinematics(Protocol):
    """One arm with its tool, as data."""

    name: ClassVar[str]
    """What kind of arm it is, as its state tells it; empty for a PSM."""

    @property
    def limits(self) -> Float64[np.ndarray, "6 2"]:
        """Lower and upper limit of each joint."""
        ...

    @property
    def max_speeds(self) -> Float64[np.ndarray, "6"]:
        """The greatest speed of each joint, per second."""
        ...

    @property
    def jaw_limit(self) -> tuple[float, float]:
        """Closed and open, in radians."""
        ...

    @property
    def jaw_max_speed(self) -> float:
        """In radians per second."""
        ...

    def forward(self, joints: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch 4 4"]:
        """`T_base_tool`, where these joints bring the tool; limits are not looked at."""
        ...

    def reach(self, T_base_tool: Float64[np.ndarray, "*batch 4 4"]) -> Solution:
        """Joints that bring the tool to each pose by itself, whatever comes before it."""
        ...

    def follow(self, T_base_tool: Float64[np.ndarray, "n 4 4"], before: Float64[np.ndarray, "6"]) -> Solution:
        """The joints along a way, each set going on from the one ahead of it and the first from `before`."""
        ...

    def problems(self, joints: Float64[np.ndarray, "*batch 6"]) -> Int64[np.ndarray, "*batch"]:
        """The first Problem of each set of joints."""
        ...

    def explain(self, problem: Problem, joints: Float64[np.ndarray, "6"]) -> str:
        """A problem of these joints in a sentence."""
        ...

    def dexterity(self, joints: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch"]:
        """How far from a singular pose, at most 1: 0 in one, where no joint brings some motion of the tool."""
        ...
