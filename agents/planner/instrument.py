"""The instrument as capsules: two fingers, the link of the wrist, and the shaft.

The shaft passes through the remote centre, the origin of the base, and the wrist's link is at right angles to the pin
and in one plane with it (shared/kinematics/psm.py), so a pose of the tool tells of all of them.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from shared.kinematics.psm import FINGER_M, LARGE_NEEDLE_DRIVER, WRIST_YAW
from shared.rigid_transforms import apply, inverse

FINGER_RADIUS_M, WRIST_RADIUS_M, SHAFT_RADIUS_M = 0.001, 0.0035, 0.0042
SHAFT_M = 0.06
"""How much of the shaft can come near the thread."""


@dataclass(frozen=True)
class Capsules:
    """At each of k poses, c capsules from start to end, in the camera frame."""

    start: Float64[np.ndarray, "k c 3"]
    end: Float64[np.ndarray, "k c 3"]
    radius_m: Float64[np.ndarray, "c"]


def instrument_at(
    T_camera_tool: Float64[np.ndarray, "k 4 4"], jaw_rad: Float64[np.ndarray, "k"], T_camera_base: np.ndarray
) -> Capsules:
    """The capsules of an instrument whose base stands there."""
    half = 0.5 * jaw_rad[:, None] * np.array([1.0, -1.0])
    tips_tool = FINGER_M * np.stack((np.zeros_like(half), np.sin(half), np.cos(half)), axis=-1)
    tips = np.einsum("kij,kfj->kfi", T_camera_tool[:, :3, :3], tips_tool) + T_camera_tool[:, None, :3, 3]
    T_base_tool = inverse(T_camera_base) @ T_camera_tool
    pin, axis = T_base_tool[:, :3, 3], T_base_tool[:, :3, 0]
    wrist = pin - LARGE_NEEDLE_DRIVER.links[WRIST_YAW].a * _unit(pin - (pin * axis).sum(axis=1, keepdims=True) * axis)
    shaft = wrist - SHAFT_M * _unit(wrist)
    pin, wrist, shaft = (apply(T_camera_base, point) for point in (pin, wrist, shaft))
    return Capsules(
        start=np.stack((pin, pin, pin, wrist), axis=1),
        end=np.stack((tips[:, 0], tips[:, 1], wrist, shaft), axis=1),
        radius_m=np.array([FINGER_RADIUS_M, FINGER_RADIUS_M, WRIST_RADIUS_M, SHAFT_RADIUS_M]),
    )


def clearances(capsules: Capsules, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "k n"]:
    """From each point to the nearest surface of the capsules at each pose; negative within one."""
    step = capsules.end - capsules.start
    squared = np.maximum((step**2).sum(axis=-1), 1e-18)
    # |p - a - x step|^2 expanded, so that nothing of size k c n 3 is made
    along = np.einsum("kcj,nj->kcn", step, points) - np.einsum("kcj,kcj->kc", step, capsules.start)[..., None]
    share = np.clip(along / squared[..., None], 0.0, 1.0)
    off = (points**2).sum(axis=-1) + ((capsules.start**2).sum(axis=-1))[..., None]
    off = off - 2.0 * np.einsum("kcj,nj->kcn", capsules.start, points)
    distance = np.sqrt(np.maximum(off - 2.0 * share * along + share**2 * squared[..., None], 0.0))
    return (distance - capsules.radius_m[:, None]).min(axis=1)


def _unit(vectors: Float64[np.ndarray, "k 3"]) -> Float64[np.ndarray, "k 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
