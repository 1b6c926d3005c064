"""What speaks against poses, before anything is sent to an arm."""

import numpy as np
from jaxtyping import Bool, Float64

from agents.robot_bridge.limits import MotionLimits, Setup
from agents.robot_bridge.path import Poses, angles_between
from agents.robot_bridge.refusals import Code, Refusal
from shared.kinematics.psm import ROLL, Problem, Psm, describe, joint_problem
from shared.kinematics.psm import inverse as inverse_kinematics
from shared.rigid_transforms import apply, inverse, orthonormality_error

_ROTATION_TOLERANCE = 1e-6


def waypoint_refusal(
    T_camera_tool: Float64[np.ndarray, "n 4 4"], jaw_rad: Float64[np.ndarray, "n"], setup: Setup
) -> Refusal | None:
    """What speaks against the first faulty waypoint; None where nothing does against any."""
    lower, upper = setup.psm.jaw_limit
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
    joints, problem = inverse_kinematics(inverse(setup.T_camera_base) @ T_camera_tool, setup.psm)
    if problem.any():
        first = _first(problem != Problem.NONE)
        return _kinematic_refusal(f"at waypoint {first}", Problem(problem[first]), joints[first], setup.psm)
    return None


def start_refusal(joints: Float64[np.ndarray, "6"], psm: Psm) -> Refusal | None:
    """What speaks against setting out from these joints."""
    problem = Problem(int(joint_problem(joints, psm)))
    return _kinematic_refusal("where the arm is now", problem, joints, psm) if problem else None


def joints_of(
    T_base_tool: Float64[np.ndarray, "n 4 4"], roll_before: float, where: str, setup: Setup
) -> Float64[np.ndarray, "n 6"] | Refusal:
    """The joints of every sample, the roll going on from where it was; or what speaks against the first faulty one."""
    points = apply(setup.T_camera_base, T_base_tool[:, :3, 3])
    if (outside := _outside_workspace(points, setup.limits)).any():
        return _workspace_refusal(where, points[_first(outside)], setup.limits)
    joints, problem = inverse_kinematics(T_base_tool, setup.psm)
    if not problem.any():
        joints[:, ROLL] = np.unwrap(np.append(roll_before, joints[:, ROLL]))[1:]
        problem = joint_problem(joints, setup.psm)
    if problem.any():
        first = _first(problem != Problem.NONE)
        return _kinematic_refusal(where, Problem(problem[first]), joints[first], setup.psm)
    return joints


def excess_speed(poses: Poses, joints: Float64[np.ndarray, "n 6"], share: float, setup: Setup) -> float:
    """By which factor the samples are too fast, at most: 1 where the fastest is just right.

    Slowed down by that factor, all are within their limits; accelerations fall with its square.
    """
    limits, psm, period_s = setup.limits, setup.psm, setup.period_s
    R = poses.T_base_tool[:, :3, :3]
    v = np.diff(poses.T_base_tool[:, :3, 3], axis=0) / period_s
    a = np.diff(v, axis=0, prepend=0.0, append=0.0) / period_s
    jaw_speed = np.abs(np.diff(poses.jaw_rad)).max() / period_s
    joint_shares = np.abs(np.diff(joints, axis=0)).max(axis=0) / period_s / psm.max_speeds
    ratios = (
        np.linalg.norm(v, axis=1).max() / (share * limits.speed),
        np.sqrt(np.linalg.norm(a, axis=1).max() / limits.acceleration),
        angles_between(R[:-1], R[1:]).max() / period_s / (share * limits.angular_speed),
        jaw_speed / (share * min(limits.jaw_speed, psm.jaw_max_speed)),
        joint_shares.max() / limits.joint_share,
    )
    return float(max(ratios))


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
    return "(" + ", ".join(f"{1e3 * value:.4g}" for value in point) + ")"


def _kinematic_refusal(where: str, problem: Problem, joints: Float64[np.ndarray, "6"], psm: Psm) -> Refusal:
    codes = {
        Problem.NOT_FINITE: Code.NOT_FINITE,
        Problem.NO_ROTATION: Code.NOT_A_POSE,
        Problem.REMOTE_CENTRE: Code.REMOTE_CENTRE,
    }
    return Refusal(codes.get(problem, Code.UNREACHABLE), f"{where} {describe(problem, joints, psm)}")
