"""Where joints bring the pin of a PSM's jaw, from its geometry alone.

The shaft passes through the remote centre, which is the origin, along

    u = (sin q1 cos q2, -sin q2, -cos q1 cos q2)

for yaw q1 and pitch q2, and ends q3 - 0.0156 m beyond it. There the wrist's first axis, across the shaft and turned by
the roll, carries a link of 9.1 mm to the pin. It shares no code with the kinematics of the bridge, which are products
of Denavit-Hartenberg matrices, so that one may judge the other.
"""

import numpy as np

SHAFT_M = -0.0156
"""From the remote centre to the shaft's end at insertion 0: 0.4162 - 0.4318."""
WRIST_M = 0.0091
LIMITS = np.array([(-1.588, 1.588), (-0.925, 0.925), (0.0, 0.24), (-4.538, 4.538), (-1.396, 1.396), (-1.396, 1.396)])
SPEEDS = np.array([np.pi / 2, np.pi / 2, 0.2, 6 * np.pi, 6 * np.pi, 6 * np.pi])
JAW_LIMITS = -0.698, 1.396
JAW_SPEED = 6 * np.pi
SHAFT_CLEARANCE_M = 0.045

FINGERS = np.array([(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
"""The tool frame in that of the wrist's last link: z stays, x is its axis."""


def about(axis: int, angle: float) -> np.ndarray:
    """The rotation about the x, y or z axis (0, 1, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def tool(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and place of the tool frame in that of the remote centre: z along the closed fingers, x the jaw's axis.

    At rest the shaft looks along -z. Yaw turns it about y and pitch about x; roll about itself; the wrist bends about
    an axis across it, and turns about one across the fingers.
    """
    yaw, pitch, insertion, roll, bend, turn = q
    shaft = about(1, -yaw) @ about(0, -pitch) @ np.diag((1.0, -1.0, -1.0))
    bent = shaft @ about(2, roll) @ about(0, -bend)
    pin = shaft[:, 2] * (insertion + SHAFT_M) + bent[:, 2] * WRIST_M
    return bent @ about(1, turn) @ FINGERS, pin
