"""The least time that a plan's way takes at the limits of speed, were there none of acceleration and jerk.

From one pose to the next the tool needs max(|Δp| / v, |Δangle| / ω, |Δjaw| / j); where there may be thread between the
fingers, v, ω and j are those of contact.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from shared.rigid_transforms import angle_between


@dataclass(frozen=True)
class SpeedLimits:
    """Of an arm: m/s, rad/s, rad/s of the jaw, and the share of them in contact."""

    speed: float
    angular_speed: float
    jaw_speed: float
    contact_share: float


def least_time_s(
    T_tool: Float64[np.ndarray, "n 4 4"],
    jaw_rad: Float64[np.ndarray, "n"],
    in_contact: Bool[np.ndarray, "n"],
    limits: SpeedLimits,
) -> float:
    """Through all poses, in one frame; `in_contact` tells of the way to each pose."""
    distance = np.linalg.norm(np.diff(T_tool[:, :3, 3], axis=0), axis=1)
    turn = angle_between(T_tool[:-1, :3, :3], T_tool[1:, :3, :3])
    # the jaws are the same after half a turn about the fingers
    turned = T_tool[1:, :3, :3] * np.array((-1.0, -1.0, 1.0))
    turn = np.minimum(turn, angle_between(T_tool[:-1, :3, :3], turned))
    jaw = np.abs(np.diff(jaw_rad))
    steps = np.max((distance / limits.speed, turn / limits.angular_speed, jaw / limits.jaw_speed), axis=0)
    return float((steps / np.where(in_contact[1:], limits.contact_share, 1.0)).sum())
