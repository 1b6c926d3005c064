"""The tool as a body, at true scale: fingers, the wrist's link and the shaft as capsules, in millimetres."""

import numpy as np
import rerun as rr
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.units import MM_PER_METRE

FINGER_RADIUS_M, WRIST_RADIUS_M, SHAFT_RADIUS_M = 0.0007, 0.0020, 0.0042
"""Of a Large Needle Driver, whose shaft is 8.4 mm thick."""


def tool_solid(fingers: Float64[np.ndarray, "2 2 3"], shaft: Float64[np.ndarray, "3 3"]) -> rr.Capsules3D:
    """Both fingers from the pin to their tips, and the way from the pin over the wrist up the shaft, in metres."""
    begins = MM_PER_METRE * np.vstack((fingers[:, 0], shaft[:2]))
    ends = MM_PER_METRE * np.vstack((fingers[:, 1], shaft[1:]))
    radii = MM_PER_METRE * np.array([FINGER_RADIUS_M, FINGER_RADIUS_M, WRIST_RADIUS_M, SHAFT_RADIUS_M])
    return rr.Capsules3D(
        lengths=np.linalg.norm(ends - begins, axis=1),
        radii=radii,
        translations=begins,
        quaternions=turns_of_z(ends - begins),
        colors=[colours.TOOL, colours.TOOL, colours.SHAFT, colours.SHAFT],
        fill_mode="solid",
    )


def turns_of_z(direction: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 4"]:
    """Quaternions (x, y, z, w) that turn the z axis into each direction on the shortest way.

    With d the unit direction, that is (z × d, 1 + z · d), normalised; straight down, half a turn about x.
    """
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    unit = np.where(length > 0, direction / np.maximum(length, np.finfo(float).tiny), (0.0, 0.0, 1.0))
    turn = np.column_stack((-unit[:, 1], unit[:, 0], np.zeros(len(unit)), 1.0 + unit[:, 2]))
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    return np.where(size > 1e-9, turn / np.maximum(size, 1e-9), (1.0, 0.0, 0.0, 0.0))
