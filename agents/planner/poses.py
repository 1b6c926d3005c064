"""Poses of the tool on the thread (paper, section III-F, after Lu et al. 2021).

The last wrist frame has z along the thread's tangent t, which is the axis about which the jaws turn, and y along the
approach: the part of a ray r across the thread,

    y = (r − (r·t) t) / ‖r − (r·t) t‖,   x = y × z,

where r is the viewing ray, or the ray from the instrument's base. The jaws look the same from both sides, so z = −t
serves as well, which is half a turn about y. The dVRK's tool frame is R_camera_tool = R_camera_wrist R_wrist_tool with
x along −z of the wrist (the jaw's axis) and z along y (the fingers).
"""

import numpy as np
from jaxtyping import Float64

from agents.planner.curve import unit_vectors
from shared.rigid_transforms import transform

R_WRIST_TOOL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
_PARALLEL = 1e-3
"""Sine below which the part of a ray across the thread is noise."""


def approach_directions(
    rays: Float64[np.ndarray, "*n 3"], tangents: Float64[np.ndarray, "*n 3"]
) -> tuple[Float64[np.ndarray, "*n 3"], Float64[np.ndarray, "*n"]]:
    """Unit vectors across the thread in the plane of ray and tangent, and the angle between those two, 0 to π/2.

    Any direction across the thread where ray and tangent are parallel.
    """
    rays = unit_vectors(rays)
    across = rays - (rays * tangents).sum(axis=-1, keepdims=True) * tangents
    sine = np.linalg.norm(across, axis=-1)
    spare = np.cross(tangents, np.eye(3)[np.argmin(np.abs(tangents), axis=-1)])
    approach = unit_vectors(np.where((sine < _PARALLEL)[..., None], spare, across))
    return approach, np.arcsin(np.clip(sine, 0.0, 1.0))


def tool_rotations(
    approach: Float64[np.ndarray, "*n 3"], jaw_axis: Float64[np.ndarray, "*n 3"]
) -> Float64[np.ndarray, "*n 3 3"]:
    """`R_camera_tool` with the fingers along the approach and the wrist's z along the jaw axis across it."""
    wrist = np.stack((np.cross(approach, jaw_axis), approach, jaw_axis), axis=-1)
    return wrist @ R_WRIST_TOOL


def tool_poses(
    points_camera: Float64[np.ndarray, "*n 3"], R_camera_tool: Float64[np.ndarray, "*n 3 3"], before_m: float
) -> Float64[np.ndarray, "*n 4 4"]:
    """`T_camera_tool` with the origin that far before the points along the fingers."""
    return transform(R_camera_tool, points_camera - before_m * R_camera_tool[..., :, 2])


def turn_between(R_a: Float64[np.ndarray, "*n 3 3"], R_b: Float64[np.ndarray, "*n 3 3"]) -> Float64[np.ndarray, "*n"]:
    """The angle of the rotation that takes one attitude to the other, in radians."""
    trace = np.einsum("...ij,...ij->...", R_a, R_b)
    return np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
