"""What speaks against poses, before anything is sent to an arm."""

import numpy as np
from jaxtyping import Bool, Float64

from agents.robot_bridge.limits import MotionLimits, Setup
from agents.robot_bridge.path import Poses
from agents.robot_bridge.plans import Code, Refusal
from shared.kinematics.arm import ArmKinematics, Problem
from shared.rigid_transforms import apply, inverse, log_so3, orthonormality_error

_ROTATION_TOLERANCE = 1e-6
_ROUNDING = 1e-9
_JUMP = 0.5
"""No joint turns so far within a tick, unless its arm goes over to another of its postures."""


def waypoint_refusal(
    T_camera_tool: Float64[np.ndarray, "n 4 4"], jaw_rad: Float64[np.ndarray, "n"], setup: Setup
) -> Refusal | None:
    """What speaks against the first faulty waypoint; None where nothing does against any."""
    lower, upper = setup.kinematics.jaw_limit
    finite = np.isfinite(T_camera_tool).all(axis=(1, 2)) & np.isfinite(jaw_rad)
    if not finite.all():
        return Refusal(Code.NOT_FINITE, f"waypoint {_first(~finite)} holds a number that is not finite")
    R, points = T_camera_tool[:, :3, :3], T_camera_tool[:, :3, 3]
    with np.errstate(over="ignore", invalid="ignore"):
        rotates = (orthonormality_error(R) < _ROTATION_TOLERANCE) & (np.linalg.det(R) > 0)
    if not rotates.all():
        return Refusal(Code.NOT_A_POSE, f"the rotation of waypoint {_first(~rotates)} is not orthonormal")
    if (outside := _outside_workspace(points, setup.limits)).any():
        return _workspace_refusal(f"at waypoint {_first(outside)}", points[_first(outside)], setup.limits)
    if (beyond := (jaw_rad < lower) | (jaw_rad > upper)).any():
        angle = f"the jaw at {jaw_rad[_first(beyond)]:.3g} rad, outside {lower} to {upper}"
        return Refusal(Code.JAW_LIMIT, f"waypoint {_first(beyond)} has {angle}")
    joints, problem = setup.kinematics.reach(inverse(setup.T_camera_base) @ T_camera_tool)
    if problem.any():
        first = _first(problem != Problem.NONE)
        return _kinematic_refusal(f"at waypoint {first}", Problem(problem[first]), joints[first], setup.kinematics)
    return None


def start_refusal(joints: Float64[np.ndarray, "6"], kinematics: ArmKinematics) -> Refusal | None:
    """What speaks against setting out from these joints."""
    problem = Problem(int(kinematics.problems(joints)))
    return _kinematic_refusal("where the arm is now", problem, joints, kinematics) if problem else None


def joints_of(
    poses: Poses, before: Float64[np.ndarray, "6"], where: str, setup: Setup
) -> Float64[np.ndarray, "n 6"] | Refusal:
    """The joints of every sample, going on from where they were; or what speaks against the first faulty one.

    Where the arm is to begin with does not have to be dextrous, but what follows must not become less so.
    """
    points = apply(setup.T_camera_base, poses.T_base_tool[:, :3, 3])
    if (outside := _outside_workspace(points, setup.limits)).any():
        return _workspace_refusal(where, points[_first(outside)], setup.limits)
    lower, upper = setup.kinematics.jaw_limit
    if (beyond := ~((poses.jaw_rad >= lower - _ROUNDING) & (poses.jaw_rad <= upper + _ROUNDING)))[1:].any():
        angle = f"the jaw at {poses.jaw_rad[1:][_first(beyond[1:])]:.3g} rad, outside {lower} to {upper}"
        return Refusal(Code.JAW_LIMIT, f"{where} is {angle}")
    joints, problem = setup.kinematics.follow(poses.T_base_tool, before)
    if problem.any():
        first = _first(problem != Problem.NONE)
        return _kinematic_refusal(where, Problem(problem[first]), joints[first], setup.kinematics)
    steps = np.abs(np.diff(joints, axis=0, prepend=before[None]))
    if (jumps := steps.max(axis=1) > _JUMP).any():
        by = f"a joint would jump by {steps[_first(jumps)].max():.2f} rad within one tick"
        return Refusal(Code.WRIST_FLIP, f"{where} {by}: the arm cannot go on as it stands")
    dexterity = setup.kinematics.dexterity(joints)
    if (stiff := dexterity < min(setup.limits.dexterity, dexterity[0] - _ROUNDING)).any():
        least = f"its dexterity would be {dexterity[stiff].min():.3f}, where {setup.limits.dexterity:g} is needed"
        return Refusal(Code.SINGULAR, f"{where} the arm comes near a singular pose: {least}")
    return joints


def excess_speed(poses: Poses, joints: Float64[np.ndarray, "n 6"], share: float, setup: Setup) -> float:
    """By which factor the samples are too fast, at most: 1 where the fastest is just right.

    Slowed down by that factor, all are within their limits of speed; accelerations fall with its square, jerks with
    its cube. Before the first sample and after the last the tool rests.
    """
    limits, kinematics, period_s = setup.limits, setup.kinematics, setup.period_s
    R = poses.T_base_tool[:, :3, :3]
    v = np.diff(poses.T_base_tool[:, :3, 3], axis=0) / period_s
    turned = log_so3(np.swapaxes(R[:-1], -1, -2) @ R[1:]) / period_s
    jaw = np.diff(poses.jaw_rad)[:, None] / period_s
    joint_speeds = np.minimum(kinematics.max_speeds, np.inf if limits.joint_speeds is None else limits.joint_speeds)
    joint_shares = np.abs(np.diff(joints, axis=0)).max(axis=0) / period_s / joint_speeds
    jaw_speed = min(limits.jaw_speed, kinematics.jaw_max_speed)
    bounds = (
        (v, share * limits.speed, limits.acceleration, limits.jerk),
        # in the base's axes, in which a steady turn is one
        (
            np.einsum("nij,nj->ni", R[:-1], turned),
            share * limits.angular_speed,
            limits.angular_acceleration,
            limits.angular_jerk,
        ),
        (jaw, share * jaw_speed, limits.jaw_acceleration, limits.jaw_jerk),
    )
    return max(float(joint_shares.max() / limits.joint_share), *(_excess(*bound, period_s) for bound in bounds))


def _excess(v: Float64[np.ndarray, "n k"], speed: float, acceleration: float, jerk: float, period_s: float) -> float:
    """By which factor of time velocities, and how they change from and to rest, keep within these."""
    a = np.diff(v, axis=0, prepend=0.0, append=0.0) / period_s
    j = np.diff(a, axis=0, prepend=0.0, append=0.0) / period_s
    largest = [float(np.linalg.norm(rows, axis=1).max()) for rows in (v, a, j)]
    return max(largest[0] / speed, (largest[1] / acceleration) ** (1 / 2), (largest[2] / jerk) ** (1 / 3))


def _outside_workspace(points_camera: Float64[np.ndarray, "n 3"], limits: MotionLimits) -> Bool[np.ndarray, "n"]:
    lower, upper = limits.workspace_camera
    return ((points_camera < lower) | (points_camera > upper)).any(axis=1)


def _first(faults: Bool[np.ndarray, "n"]) -> int:
    return int(np.argmax(faults))


def _workspace_refusal(where: str, point: Float64[np.ndarray, "3"], limits: MotionLimits) -> Refusal:
    lower, upper = (_millimetres(corner) for corner in limits.workspace_camera)
    place = f"the tool would be at {_millimetres(point)} mm before the camera"
    return Refusal(Code.WORKSPACE, f"{where} {place}, outside the workspace from {lower} to {upper} mm")


def _millimetres(point: Float64[np.ndarray, "3"]) -> str:
    return "(" + ", ".join(f"{1e3 * float(value):.4g}" for value in point) + ")"


def _kinematic_refusal(
    where: str, problem: Problem, joints: Float64[np.ndarray, "6"], kinematics: ArmKinematics
) -> Refusal:
    codes = {
        Problem.NOT_FINITE: Code.NOT_FINITE,
        Problem.NO_ROTATION: Code.NOT_A_POSE,
        Problem.REMOTE_CENTRE: Code.REMOTE_CENTRE,
    }
    return Refusal(codes.get(problem, Code.UNREACHABLE), f"{where} {kinematics.explain(problem, joints)}")
