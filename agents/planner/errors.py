"""How far the thread may be from where the fingers are taken to be, in the camera frame.

Three errors add up, independent of each other, each taken as normal:

- of the reconstruction: its posterior covariance at the place;
- of the tool, new with each attempt: `tool_error_m` per axis;
- of the registration, the same for all attempts with an arm: at most `hand_eye_error_m`, anywhere in that ball, which
  has a variance of r² / 5 per axis. A turn by a degree about the working point moves fingertips 10 mm away by 0.2 mm,
  and counts with the first.

What a miss tells of the last one is in `learning.py`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from schemas.messages import ThreadReconstruction

UNIFORM_BALL = 5.0
"""r² over the variance per axis."""


@dataclass(frozen=True)
class Offset:
    """The constant part: where the fingers truly are, less where they are measured to be, as mean and covariance."""

    mean_camera: Float64[np.ndarray, "3"]
    covariance: Float64[np.ndarray, "3 3"]


def unknown_offset(config: PlannerConfig) -> Offset:
    """What is known of it before any attempt."""
    return Offset(np.zeros(3), config.hand_eye_error_m**2 / UNIFORM_BALL * np.eye(3))


def tool_covariance(config: PlannerConfig) -> Float64[np.ndarray, "3 3"]:
    """Of the part that is new with each attempt."""
    return config.tool_error_m**2 * np.eye(3)


def thread_covariance(
    thread: ThreadReconstruction, curve: ThreadCurve, s: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n 3 3"] | None:
    """Of the points at shares of the thread's length, in m²; None where the method of reconstruction tells of none."""
    if not len(thread.posterior_s):
        return None
    unit_m = thread.camera.metres_per_unit or 1.0
    order = np.argsort(thread.posterior_s, kind="stable")
    known_at = thread.posterior_s[order]
    told = unit_m**2 * thread.posterior_covariance[order].reshape(-1, 9)
    at = curve.parameters(s)
    return np.stack([np.interp(at, known_at, one) for one in told.T], axis=-1).reshape(-1, 3, 3)


def across_jaw(
    R_camera_tool: Float64[np.ndarray, "*n 3 3"], covariance: Float64[np.ndarray, "*n 3 3"]
) -> Float64[np.ndarray, "*n 2 2"]:
    """A covariance in y and z of the tool: the way the fingers open, and along them."""
    plane = R_camera_tool[..., :, 1:]
    return np.einsum("...ki,...kl,...lj->...ij", plane, covariance, plane)
