"""Whether a motion would bring a finger into the tissue, by the newest surface that was measured.

The planner judges grasps by the same surface, with its uncertainty. This looks at the whole way, the one to the grasp
too, and refuses only what is clearly wrong: a point of a finger more than `press_m` and three deviations behind the
surface along its viewing ray. What is not measured speaks against nothing there; nor does what was measured where the
arm's own tool is, which is in front of the tissue. Where the fingers come to the thread, a real arm needs it measured.
"""

import cv2
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
BRIDGED_CELLS = 2
"""What thread hides of the tissue is known from cells so near, as the planner bridges it."""


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
    row, column = _cells(surface, points)
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


def measured_at(surface: TissueSurface, T_camera_tool: Float64[np.ndarray, "n 4 4"]) -> bool:
    """Whether the tissue was measured at, or right beside, every place that the tips are at in these poses."""
    tips = apply(T_camera_tool, np.array(((0.0, 0.0, FINGER_M),)))[:, 0]
    row, column = _cells(surface, np.where(tips[:, 2:] > 0, tips, np.nan))
    side = 2 * BRIDGED_CELLS + 1
    near = cv2.dilate(surface.valid.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    return bool(((row >= 0) & (column >= 0) & near[row, column]).all())


def _cells(surface: TissueSurface, points_camera: Float64[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the cell that each point is seen in; -1 where it is seen in none."""
    u = surface.camera.fx_px * points_camera[:, 0] / points_camera[:, 2] + surface.camera.cx_px
    v = surface.camera.fy_px * points_camera[:, 1] / points_camera[:, 2] + surface.camera.cy_px
    return _cell(surface.v_px, v), _cell(surface.u_px, u)


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
