"""Joints of a pose, and poses as ROS has them: what the console needs for `servo_cp`, `move_cp` and `measured_cp`.

The inverse follows from the geometry of geometry.py. The wrist's second axis w is against the tool's x. The link b from
the shaft's end to the pin is at right angles to w and to the wrist's first axis, on which the remote centre looks at a
right angle; so b lies in the plane of w and the pin's place p,

    b = (p - (p·w) w) / |p - (p·w) w|,

and what is left of p without the link is the shaft. Joints are what remains of the rotation, turn by turn.
"""

import numpy as np

from agents.dvrk_emulator.geometry import FINGERS, SHAFT_M, WRIST_M, about
from agents.dvrk_emulator.messages import Point, Pose, Quaternion

ROLL = 3
_FULL_TURN = 2 * np.pi


def joints_at(R: np.ndarray, pin: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Six joints that bring the tool there, the roll by whole turns as near as can be to the one before.

    NaN where there are none. Limits are not looked at.
    """
    w = -R[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        b = _unit(pin - (pin @ w) * w)
        end = pin - WRIST_M * b
        u = _unit(end)
    yaw, pitch = np.arctan2(u[0], -u[2]), -np.arcsin(np.clip(u[1], -1, 1))
    shaft = about(1, -yaw) @ about(0, -pitch) @ np.diag((1.0, -1.0, -1.0))
    bent = np.stack((np.cross(w, b), w, b), axis=1)
    rolled = shaft.T @ bent
    roll = np.arctan2(rolled[1, 0], rolled[0, 0])
    roll += _FULL_TURN * np.round((before[ROLL] - roll) / _FULL_TURN)
    bend = np.arctan2(-rolled[2, 1], rolled[2, 2])
    turned = bent.T @ R @ FINGERS.T
    return np.array((yaw, pitch, np.linalg.norm(end) - SHAFT_M, roll, bend, np.arctan2(turned[0, 2], turned[2, 2])))


def told(R: np.ndarray, pin: np.ndarray) -> Pose:
    """A rotation and a place as a message."""
    # Shepperd's choice: the largest of the four squares is divided by
    squares = np.array((np.trace(R), R[0, 0], R[1, 1], R[2, 2]))
    largest = int(np.argmax(squares))
    if largest == 0:
        q = np.array((1 + squares[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]))
    else:
        i, j, k = largest - 1, largest % 3, (largest + 1) % 3
        q = np.zeros(4)
        q[0], q[i + 1] = R[k, j] - R[j, k], 1 + R[i, i] - R[j, j] - R[k, k]
        q[j + 1], q[k + 1] = R[j, i] + R[i, j], R[k, i] + R[i, k]
    w, x, y, z = (float(value) for value in q / np.linalg.norm(q))
    return Pose(Point(*(float(value) for value in pin)), Quaternion(x, y, z, w))


def read(pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """The rotation and the place of a message; NaN where its quaternion is none."""
    at, turned = pose.position, pose.orientation
    q = np.array((turned.x, turned.y, turned.z))
    norm = np.sqrt(q @ q + turned.w**2)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        (x, y, z), w = q / norm, turned.w / norm
    K = np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)])
    return np.eye(3) + 2 * (w * K + K @ K), np.array((at.x, at.y, at.z))


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
