"""Where arms have their tools: what was measured there is a tool, and nothing is known of tissue behind it."""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64

from schemas.messages import RobotState, TissueSurface
from shared.camera import backproject
from shared.kinematics.psm import FINGER_M, LARGE_NEEDLE_DRIVER, WRIST_YAW
from shared.rigid_transforms import apply, compose


def tool_cells(surface: TissueSurface, arms: Iterable[RobotState], near_m: float) -> Bool[np.ndarray, "r c"]:
    """Which cells of a surface of known unit lie so near to the axis of an arm's tool, as it is measured."""
    row, column = np.nonzero(surface.valid)
    pixel = np.column_stack((surface.u_px[column], surface.v_px[row]))
    unit_m = surface.camera.metres_per_unit or 0.0
    points_m = unit_m * backproject(surface.camera, pixel, surface.depth[row, column])
    near = np.zeros(len(points_m), bool)
    for arm in arms:
        axis = tool_axis(arm)
        for start, end in pairwise(axis):
            near |= _distance(points_m, start, end) <= near_m
    hidden = np.zeros(surface.valid.shape, bool)
    hidden[row[near], column[near]] = True
    return hidden


def tool_axis(arm: RobotState) -> Float64[np.ndarray, "4 3"]:
    """From the tips of the fingers over the pin and the wrist to the remote centre, in the camera frame.

    The wrist's link is at right angles to the pin and in one plane with the shaft (shared/kinematics/psm.py).
    """
    pin, along_pin = arm.T_base_tool[:3, 3], arm.T_base_tool[:3, 0]
    back = pin - (pin @ along_pin) * along_pin
    wrist = pin - LARGE_NEEDLE_DRIVER.links[WRIST_YAW].a * back / max(float(np.linalg.norm(back)), 1e-9)
    tips = apply(compose(arm.T_camera_base, arm.T_base_tool), np.array([[0.0, 0.0, FINGER_M]]))
    return np.concatenate((tips, apply(arm.T_camera_base, np.stack((pin, wrist, np.zeros(3))))))


def _distance(
    points: Float64[np.ndarray, "n 3"], start: Float64[np.ndarray, "3"], end: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "n"]:
    """From points to a straight piece."""
    step = end - start
    share = np.clip((points - start) @ step / max(float(step @ step), 1e-18), 0.0, 1.0)
    return np.linalg.norm(points - start - share[:, None] * step, axis=1)
