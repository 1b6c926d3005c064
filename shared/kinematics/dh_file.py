"""An arm from what a file says of it: docs/robot_bridge.md."""

from typing import Any

import numpy as np

from shared.kinematics.arm import JOINTS, Link
from shared.kinematics.dh import DhArm, pose_problem

ANGLES_AND_LENGTHS = ("alpha", "a", "theta", "d")


def read_dh(told: dict[str, Any]) -> DhArm:
    """An arm from a table of joints, a jaw, a length and the tool frame in that of the last joint.

    Raises:
        ValueError: where the file says too little, or something that is no arm; the text names the key.
    """
    try:
        rows = tuple(_row(joint) for joint in told["joints"])
        T_last_tool = np.array(told.get("T_last_tool", np.eye(4)), np.float64)
        jaw_limit, jaw_speed = _pair(told["jaw"]["limit"]), float(told["jaw"]["max_speed"])
        length_m = float(told["length_m"])
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise ValueError(f"it lacks a key, or has something else there: {error}") from None
    if len(rows) != JOINTS:
        raise ValueError(f"it has {len(rows)} joints, where there must be {JOINTS}")
    if T_last_tool.shape != (4, 4) or pose_problem(T_last_tool[None])[0]:
        raise ValueError("its T_last_tool is no rigid transform")
    if not all(row.limit[0] < row.limit[1] and row.max_speed > 0 for row in rows) or not length_m > 0:
        raise ValueError("each of its limits must lead from below to above, and speeds and length_m be above 0")
    return DhArm(rows, T_last_tool, jaw_limit, jaw_speed, length_m)


def _row(joint: dict[str, Any]) -> Link:
    alpha, a, theta, d = (float(joint.get(name, 0.0)) for name in ANGLES_AND_LENGTHS)
    return Link(alpha, a, theta, d, bool(joint.get("slides", False)), _pair(joint["limit"]), float(joint["max_speed"]))


def _pair(values: Any) -> tuple[float, float]:
    return float(values[0]), float(values[1])
