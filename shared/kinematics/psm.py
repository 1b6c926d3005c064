"""Kinematics of a patient-side manipulator (PSM) of the da Vinci research kit, any number of poses at once.

The base frame has its origin at the remote centre, the point of the trocar that the shaft always passes through. The
tool frame sits on the pin of the jaw: z along the closed fingers, x the axis about which they open. Joints are yaw,
pitch, insertion, roll, wrist pitch and wrist yaw, in radians and metres; rows of the table are in modified
Denavit-Hartenberg form (Craig), frame i in frame i-1 being

    Rot_x(α) · Trans_x(a) · Rot_z(θ) · Trans_z(d).

The inverse is closed. Of the wrist's last frame let x lead from the pitch axis to the pin, a long, z be the pin
(z = -x_tool) and p its place. The pitch axis is x × z and meets the shaft, which passes through the origin, at a right
angle; so (x × z)·p = 0, and x lies in the plane of z and p. Being at right angles to z as well,

    x = (p - (p·z) z) / |p - (p·z) z|,      shaft's end c = p - a x,      shaft's direction u = c / |c|.

The opposite sign of x folds the wrist back beyond its limits. u = (sin q₁ cos q₂, -sin q₂, -cos q₁ cos q₂) gives yaw
and pitch, |c| the insertion, and x × z, x and z_tool seen from the frames before them give roll and wrist. It fails
where the pin points at the remote centre (the wrist would have to bend by 90°, and it cannot), and the arm is never
taken so deep into its trocar that c comes near the origin.

Source of the numbers: jhu-dvrk/sawIntuitiveResearchKit, PSM Classic with Large Needle Driver 400006.
"""

import functools
import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from shared.kinematics.arm import Link, Problem, Solution
from shared.rigid_transforms import orthonormality_error, transform

YAW, PITCH, INSERTION, ROLL, WRIST_PITCH, WRIST_YAW = range(6)
JOINT_NAMES = ("yaw", "pitch", "insertion", "roll", "wrist pitch", "wrist yaw")

FINGER_M = 0.0102
"""From the pin to the tip of a finger."""
WRIST_M = 0.0091
"""From the shaft's end to the pin."""


def finger_tips(jaw_rad: float) -> Float64[np.ndarray, "2 3"]:
    """The tips of both fingers in the tool frame, in metres: each is opened by half the jaw's angle about x_tool."""
    half = 0.5 * jaw_rad * np.array([1.0, -1.0])
    return FINGER_M * np.stack((np.zeros(2), np.sin(half), np.cos(half)), axis=1)


_ROTATION_TOLERANCE = 1e-6
_LIMIT_TOLERANCE = 1e-9
"""Rounding of the inverse at a limit does not make a pose unreachable."""


@dataclass(frozen=True)
class Psm:
    """A PSM with its tool as data. Another tool, or the Si arm, has other numbers in the same places.

    Fields:
        links: yaw, pitch, insertion, roll, wrist pitch, wrist yaw; limits and speeds in radians, metres and seconds.
        R_wrist_tool: the tool frame in the last frame of the table.
        jaw_limit: closed (negative squeezes) and open; each finger opens by half the angle.
        shaft_clearance: how far the shaft's end must stay beyond the remote centre, so that the wrist is out of the
            trocar.
    """

    links: tuple[Link, Link, Link, Link, Link, Link]
    R_wrist_tool: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    jaw_limit: tuple[float, float]
    jaw_max_speed: float
    shaft_clearance: float

    name: ClassVar[str] = ""

    @property
    def limits(self) -> Float64[np.ndarray, "6 2"]:
        """Lower and upper limit of each joint."""
        return np.array([link.limit for link in self.links])

    @property
    def max_speeds(self) -> Float64[np.ndarray, "6"]:
        """The greatest speed of each joint."""
        return np.array([link.max_speed for link in self.links])

    @property
    def shaft_offset(self) -> float:
        """From the remote centre to the shaft's end at insertion 0; negative where the end is then outside."""
        return self.links[INSERTION].d + self.links[ROLL].d

    def forward(self, joints: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch 4 4"]:
        """`T_base_tool`, where these joints bring the tool."""
        return forward(joints, self)

    def reach(self, T_base_tool: Float64[np.ndarray, "*batch 4 4"]) -> Solution:
        """The joints that bring the tool to each pose, the roll within ±π."""
        return inverse(T_base_tool, self)

    def follow(self, T_base_tool: Float64[np.ndarray, "n 4 4"], before: Float64[np.ndarray, "6"]) -> Solution:
        """The joints along a way: there is one set for each pose but for whole turns of the roll, which goes on."""
        joints, problem = inverse(T_base_tool, self)
        if not problem.any():
            joints[:, ROLL] = np.unwrap(np.append(before[ROLL], joints[:, ROLL]))[1:]
            problem = joint_problem(joints, self)
        return Solution(joints, problem)

    def problems(self, joints: Float64[np.ndarray, "*batch 6"]) -> Int64[np.ndarray, "*batch"]:
        """The first Problem of each set of joints."""
        return joint_problem(joints, self)

    def explain(self, problem: Problem, joints: Float64[np.ndarray, "6"]) -> str:
        """A problem of these joints in a sentence."""
        return describe(problem, joints, self)

    def dexterity(self, joints: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch"]:
        """How far the pin is from pointing at the remote centre, and the shaft from the yaw axis: a product of sines.

        With the link's length a, the shaft's l and the wrist's bend q, the pin's place at right angles to the pin is
        a + l cos q long; where that is 0, roll and wrist yaw move the tool alike (the module's derivation fails there).
        """
        a, shaft = self.links[WRIST_YAW].a, joints[..., INSERTION] + self.shaft_offset
        across, along = a + shaft * np.cos(joints[..., WRIST_PITCH]), shaft * np.sin(joints[..., WRIST_PITCH])
        distance = np.maximum(np.hypot(across, along), _LIMIT_TOLERANCE)
        return np.cos(joints[..., PITCH]) * np.abs(across) / distance


_QUARTER = math.pi / 2
_THREE_TURNS = 6 * math.pi

LARGE_NEEDLE_DRIVER = Psm(
    links=(
        Link(_QUARTER, 0, _QUARTER, 0, False, (-1.588, 1.588), math.radians(90)),
        Link(-_QUARTER, 0, -_QUARTER, 0, False, (-0.925, 0.925), math.radians(90)),
        Link(_QUARTER, 0, 0, -0.4318, True, (0, 0.24), 0.2),
        Link(0, 0, 0, 0.4162, False, (-4.538, 4.538), _THREE_TURNS),
        Link(-_QUARTER, 0, -_QUARTER, 0, False, (-1.396, 1.396), _THREE_TURNS),
        Link(-_QUARTER, 0.0091, -_QUARTER, 0, False, (-1.396, 1.396), _THREE_TURNS),
    ),
    R_wrist_tool=((0, -1, 0), (0, 0, 1), (-1, 0, 0)),
    jaw_limit=(-0.698, 1.396),
    jaw_max_speed=_THREE_TURNS,
    shaft_clearance=0.045,
)
"""PSM Classic with the Large Needle Driver 400006."""


def forward(
    joints: Float64[np.ndarray, "*batch 6"], psm: Psm = LARGE_NEEDLE_DRIVER
) -> Float64[np.ndarray, "*batch 4 4"]:
    """`T_base_tool`, where these joints bring the tool. Limits are not looked at."""
    T_before_link = _link_transforms(joints, _rows(psm))
    T_base_link = T_before_link[..., 0, :, :]
    for index in range(1, len(psm.links)):
        T_base_link = T_base_link @ T_before_link[..., index, :, :]
    R_base_tool = T_base_link[..., :3, :3] @ np.array(psm.R_wrist_tool, dtype=np.float64)
    return transform(R_base_tool, T_base_link[..., :3, 3])


def inverse(T_base_tool: Float64[np.ndarray, "*batch 4 4"], psm: Psm = LARGE_NEEDLE_DRIVER) -> Solution:
    """The joints that bring the tool to each pose, with the roll within ±π, and what forbids them if anything does.

    A path must unwrap the roll, which may pass ±π (`numpy.unwrap`), and look at `joint_problem` again.
    """
    pose = _pose_problem(T_base_tool)
    sound = np.where((pose == Problem.NONE)[..., None, None], T_base_tool, np.eye(4))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore", under="ignore"):
        joints = _solve(sound, psm)
    joints[pose != Problem.NONE] = np.nan
    folded = (pose == Problem.NONE) & np.isnan(joints).any(axis=-1)
    problem = np.where(pose == Problem.NONE, joint_problem(joints, psm), pose)
    return Solution(joints, np.where(folded, Problem.WRIST_FOLDED, problem))


def shaft_and_pin(T_base_tool: Float64[np.ndarray, "4 4"]) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """The Large Needle Driver's end of the shaft, and the jaw's pin, in the base's frame."""
    pin, axis = T_base_tool[:3, 3], -T_base_tool[:3, 0]
    x = pin - (pin @ axis) * axis
    return pin - WRIST_M * x / np.linalg.norm(x), pin


def joint_problem(
    joints: Float64[np.ndarray, "*batch 6"], psm: Psm = LARGE_NEEDLE_DRIVER
) -> Int64[np.ndarray, "*batch"]:
    """The first Problem of each set of joints: not finite, too near the remote centre, outside a limit."""
    limits = psm.limits
    finite = np.isfinite(joints).all(axis=-1)
    shallow = joints[..., INSERTION] + psm.shaft_offset < psm.shaft_clearance - _LIMIT_TOLERANCE
    outside = (joints < limits[:, 0] - _LIMIT_TOLERANCE) | (joints > limits[:, 1] + _LIMIT_TOLERANCE)
    limit = np.where(outside.any(axis=-1), Problem.YAW + np.argmax(outside, axis=-1), Problem.NONE)
    return np.where(finite, np.where(shallow, Problem.REMOTE_CENTRE, limit), Problem.NOT_FINITE)


def describe(problem: Problem, joints: Float64[np.ndarray, "6"], psm: Psm = LARGE_NEEDLE_DRIVER) -> str:
    """A problem of these joints in a sentence."""
    if problem >= Problem.YAW:
        joint = problem - Problem.YAW
        (lower, upper), unit = psm.links[joint].limit, "m" if psm.links[joint].slides else "rad"
        return f"the {JOINT_NAMES[joint]} joint would be at {joints[joint]:.4g} {unit}, outside {lower} to {upper}"
    if problem is Problem.REMOTE_CENTRE:
        beyond = 1e3 * (joints[INSERTION] + psm.shaft_offset)
        needed = 1e3 * psm.shaft_clearance
        return f"the shaft would end {beyond:.1f} mm beyond the remote centre, where {needed:.0f} mm are needed"
    return {
        Problem.NONE: "there is no problem",
        Problem.NOT_FINITE: "a number of it is not finite",
        Problem.NO_ROTATION: "it is no rigid transform: its rotation is not orthonormal, or its last row not 0 0 0 1",
        Problem.WRIST_FOLDED: "the pin of the jaw would point at the remote centre, and the wrist cannot bend so far",
    }[problem]


class _Rows(NamedTuple):
    """The table by its columns; `cos_alpha` and `sin_alpha` of each link, and 1 in `slides` where it does."""

    cos_alpha: Float64[np.ndarray, "6"]
    sin_alpha: Float64[np.ndarray, "6"]
    a: Float64[np.ndarray, "6"]
    theta: Float64[np.ndarray, "6"]
    d: Float64[np.ndarray, "6"]
    slides: Float64[np.ndarray, "6"]


@functools.cache
def _rows(psm: Psm) -> _Rows:
    alpha, a, theta, d, slides = np.array([link[:5] for link in psm.links], dtype=np.float64).T
    return _Rows(np.cos(alpha), np.sin(alpha), a, theta, d, slides)


def _link_transforms(joints: Float64[np.ndarray, "*batch 6"], rows: _Rows) -> Float64[np.ndarray, "*batch 6 4 4"]:
    """Each link's frame in that of the one before it."""
    theta, d = rows.theta + (1 - rows.slides) * joints, rows.d + rows.slides * joints
    c, s, ca, sa = np.cos(theta), np.sin(theta), rows.cos_alpha, rows.sin_alpha
    T = np.zeros((*joints.shape, 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 3] = c, -s, rows.a
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2], T[..., 1, 3] = s * ca, c * ca, -sa, -d * sa
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2], T[..., 2, 3] = s * sa, c * sa, ca, d * ca
    T[..., 3, 3] = 1
    return T


def _pose_problem(T: Float64[np.ndarray, "*batch 4 4"]) -> Int64[np.ndarray, "*batch"]:
    R = T[..., :3, :3]
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        rotates = (orthonormality_error(R) < _ROTATION_TOLERANCE) & (np.linalg.det(R) > 0)
    rigid = rotates & (T[..., 3, :] == (0, 0, 0, 1)).all(axis=-1)
    finite = np.isfinite(T).all(axis=(-2, -1))
    return np.where(finite, np.where(rigid, Problem.NONE, Problem.NO_ROTATION), Problem.NOT_FINITE)


def _solve(T_base_tool: Float64[np.ndarray, "*batch 4 4"], psm: Psm) -> Float64[np.ndarray, "*batch 6"]:
    """The module's derivation; NaN where the pin points at the remote centre."""
    R_base_wrist = T_base_tool[..., :3, :3] @ np.array(psm.R_wrist_tool, dtype=np.float64).T
    p, fingers, pin = T_base_tool[..., :3, 3], T_base_tool[..., :3, 2], R_base_wrist[..., 2]
    x = _unit(p - _dot(p, pin)[..., None] * pin)
    pitch_axis = np.cross(x, pin)
    end = p - psm.links[WRIST_YAW].a * x
    u = _unit(end)
    yaw = np.arctan2(u[..., 0], -u[..., 2])
    pitch = np.arctan2(-u[..., 1], np.hypot(u[..., 0], u[..., 2]))
    x_shaft = np.stack((-np.sin(yaw) * np.sin(pitch), -np.cos(pitch), np.cos(yaw) * np.sin(pitch)), axis=-1)
    y_shaft = np.cross(u, x_shaft)
    roll = np.arctan2(-_dot(pitch_axis, x_shaft), _dot(pitch_axis, y_shaft))
    x_rolled = np.cos(roll)[..., None] * x_shaft + np.sin(roll)[..., None] * y_shaft
    wrist_pitch = np.arctan2(_dot(x, x_rolled), _dot(x, u))
    wrist_yaw = np.arctan2(-_dot(fingers, pitch_axis), _dot(fingers, x))
    insertion = np.linalg.norm(end, axis=-1) - psm.shaft_offset
    return np.stack((yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw), axis=-1)


def _dot(a: Float64[np.ndarray, "*batch 3"], b: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch"]:
    return np.einsum("...i,...i->...", a, b)


def _unit(v: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3"]:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
