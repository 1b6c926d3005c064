"""How far tools are from where they are measured: by hand-eye calibration for good, and anew for each plan."""

import zlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from agents.simulator.field import MM
from shared.rigid_transforms import transform

_HAND_EYE = 77
"""Keeps this draw apart from those for plans."""


@dataclass(frozen=True)
class ToolError:
    """How far an arm's tool is from where it is measured, while it carries out its n-th plan."""

    plan_id: str
    plans: int
    offset_camera: Float64[np.ndarray, "3"]


def hand_eye_error(
    seed: int, arm: str, most_mm: float, most_deg: float, about_camera: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "4 4"]:
    """What takes measured poses of an arm's tool to the true ones, in the camera's frame.

    A shift of 0 to `most_mm` and a turn of 0 to `most_deg` about a point, each evenly drawn and in any direction.
    """
    rng = np.random.default_rng([seed, zlib.crc32(arm.encode()), _HAND_EYE, _HAND_EYE])
    ways = rng.normal(size=(2, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    shift_m, turn_rad = rng.uniform(0.0, (MM * most_mm, np.radians(most_deg)))
    R = Rotation.from_rotvec(turn_rad * ways[1]).as_matrix()
    return transform(R, about_camera - R @ about_camera + shift_m * ways[0])


def tool_error(seed: int, arm: str, plan_id: str, plans: int, deviation_mm: float) -> ToolError:
    """The error of an arm's tool in its next plan, after so many."""
    rng = np.random.default_rng([seed, zlib.crc32(arm.encode()), plans])
    return ToolError(plan_id, plans + 1, rng.normal(0.0, MM * deviation_mm, 3))
