"""Whether a motion would bring a finger into the tissue, by the newest surface that was measured.

The planner judges grasps by the same surface, with its uncertainty. This looks at the whole way, the one to the grasp
too, and refuses only what is clearly wrong: a point of a finger more than `press_m` and three deviations behind the
surface along its viewing ray. What is not measured speaks against nothing; nor does what was measured where the arm's
own tool is, which is in front of the tissue.
"""

import numpy as np
from jaxtyping import Bool, Float64

from agents.robot_bridge.limits import MotionLimits
from agents.robot_bridge.path import Poses
from agents.robot_bridge.plans import Code, Refusal
from schemas.messages import TissueSurface
from shared.camera import backproject
from shared.kinematics.psm import FINGER_M
from shared.rigid_transforms import apply

SIGMAS, TOOL_M = 3.0, 0.012
ALONG = np.array((0.0, 0.5, 1.0))
"""Shares of a finger's length that are looked at."""


def fingers_of(poses: Poses) -> Float64[np.ndarray, "n p 3"]:
    """Points of both fingers, in the frame of the poses."""
    half = 0.5 * poses.jaw_rad[:, None] * np.ones(len(ALONG))
    along = FINGER_M * ALONG
    one = np.stack((np.zeros_like(half), along * np.sin(half), along * np.cos(half)), axis=-1)
    return apply(poses.T_base_tool, np.concatenate((one, one * (1.0, -1.0, 1.0)), axis=1))


def tissue_refusal(
    surface: TissueSurface, T_camera_tool: Float64[np.ndarray, "4 4"], poses: Poses, limits: MotionLimits, where: str
) -> Refusal | None:
    """What speaks against poses in the camera frame; None where nothing does, or nothing is known.

    Args:
        T_camera_tool: where the tool is now.
    """
    unit_m = surface.camera.metres_per_unit
    if unit_m is None or not surface.valid.any():
        return None
    points = fingers_of(poses)
    samples = points.shape[:2]
    points = points.reshape(-1, 3)
    points = np.where(points[:, 2:] > 0, points, np.nan)
    u = surface.camera.fx_px * points[:, 0] / points[:, 2] + surface.camera.cx_px
    v = surface.camera.fy_px * points[:, 1] / points[:, 2] + surface.camera.cy_px
    column, row = _cell(surface.u_px, u), _cell(surface.v_px, v)
    known = (surface.valid & ~_tool_cells(surface, unit_m, T_camera_tool))[row, column] & (column >= 0) & (row >= 0)
    deviation = 0.0 if surface.deviation is None else surface.deviation[row, column]
    behind = np.where(known, points[:, 2] - unit_m * (surface.depth[row, column] + SIGMAS * deviation), -np.inf)
    by_sample = behind.reshape(samples).max(axis=1)
    # whoever is in the tissue already may leave
    allowed, deepest = max(limits.press_m, float(by_sample[0])), float(by_sample.max())
    if deepest <= allowed:
        return None
    depth = (
        f"{1e3 * deepest:.1f} mm behind the tissue as it was measured, where {1e3 * limits.press_m:g} mm are allowed"
    )
    return Refusal(Code.TISSUE, f"{where} a finger would be {depth}")


def _cell(middles: Float64[np.ndarray, "c"], at: Float64[np.ndarray, "n"]) -> np.ndarray:
    """The nearest cell of each place; -1 outside of the grid."""
    half = 0.5 * (middles[-1] - middles[0]) / max(len(middles) - 1, 1)
    with np.errstate(invalid="ignore"):
        inside = (at >= middles[0] - half) & (at <= middles[-1] + half)
    nearest = np.rint(np.interp(np.where(inside, at, middles[0]), middles, np.arange(len(middles))))
    return np.where(inside, nearest, -1).astype(np.intp)


def _tool_cells(
    surface: TissueSurface, unit_m: float, T_camera_tool: Float64[np.ndarray, "4 4"]
) -> Bool[np.ndarray, "r c"]:
    """Cells whose rays pass near the tool, from its tips to where it comes into the image."""
    row, column = np.nonzero(surface.valid)
    pixels = np.column_stack((surface.u_px[column], surface.v_px[row]))
    seen = unit_m * backproject(surface.camera, pixels, surface.depth[row, column])
    axis = apply(T_camera_tool, np.array((0.0, 0.0, 1.0)) * np.linspace(FINGER_M, -0.1, 40)[:, None])
    near = np.zeros(len(seen), bool)
    for place in axis[axis[:, 2] > 0]:
        ray = seen * (place[2] / seen[:, 2])[:, None]
        near |= np.linalg.norm(ray - place, axis=1) < TOOL_M
    hidden = np.zeros(surface.valid.shape, bool)
    hidden[row[near], column[near]] = True
    return hidden
