"""A smooth way through poses, from rest to rest.

Position, quaternion and jaw angle run through the waypoints as monotone cubics (PCHIP; Fritsch and Carlson, SIAM J.
Numer. Anal. 17, 1980): smooth, and never outside the box that two neighbours span, so the tool does not swing out
behind a waypoint. Their parameter ξ is the time that the way would take at full speed,

    ξ = Σ max(|Δp| / v, |Δangle| / ω, |Δjaw| / j),

and a quaternion between two waypoints is normalised, which keeps it on the great arc of slerp.

In time, ξ's rate rises from rest along the smoothstep 3x² - 2x³ within t_r, stays at 1, and falls likewise, with
t_r = 1.5 max(v / a, ω / α), the steepest slope of a smoothstep being 1.5 / t_r. A way with ξ < t_r peaks at
√(ξ / t_r). Cubics run faster than their chords in places; the caller looks at the samples and slows the path down.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import PchipInterpolator

from agents.robot_bridge.limits import MotionLimits
from shared.rigid_transforms import log_so3, quaternion_from_rotation, rotation_from_quaternion, transform

_NO_WAY_S = 1e-9
"""Waypoints nearer than this in ξ are the same."""


class Poses(NamedTuple):
    """Poses of the tool with the angle of its jaw."""

    T_base_tool: Float64[np.ndarray, "n 4 4"]
    jaw_rad: Float64[np.ndarray, "n"]


@dataclass(frozen=True, eq=False)
class Path:
    """The way through poses as rows of position, quaternion and jaw angle over ξ, and the time law along it.

    Fields:
        ramp_s: from rest to the peak of ξ's rate.
    """

    curve: PchipInterpolator
    xi_end: float
    peak: float
    ramp_s: float

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.xi_end / self.peak + self.ramp_s

    def sample(self, period_s: float, slowing: float = 1.0) -> Poses:
        """The poses of every tick from start to end when each moment lasts `slowing` times as long."""
        ticks = np.arange(np.ceil(self.duration_s * slowing / period_s) + 1)
        rows = self.curve(self._travelled(np.minimum(ticks * (period_s / slowing), self.duration_s)))
        return Poses(transform(rotation_from_quaternion(rows[:, 3:7]), rows[:, :3]), rows[:, 7])

    def _travelled(self, t: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
        """ξ at each time: the rate's integral, which is the same seen from either end."""
        from_nearer_end = np.minimum(t, self.duration_s - t)
        x = np.clip(from_nearer_end / self.ramp_s, 0, 1)
        near = self.peak * (self.ramp_s * (x**3 - x**4 / 2) + np.maximum(from_nearer_end - self.ramp_s, 0))
        return np.where(t > self.duration_s / 2, self.xi_end - near, near)


def smooth_path(waypoints: Poses, limits: MotionLimits, share: float) -> Path | None:
    """The way through poses at a share of full speed; None where they are all the same."""
    steps = _full_speed_steps(waypoints, limits) / share
    kept = np.append(True, steps > _NO_WAY_S)
    xi = np.append(0.0, np.cumsum(steps[kept[1:]]))
    if len(xi) == 1:
        return None
    longest_ramp_s = 1.5 * max(limits.speed / limits.acceleration, limits.angular_speed / limits.angular_acceleration)
    peak = min(1.0, float(np.sqrt(xi[-1] / longest_ramp_s)))
    with np.errstate(over="ignore"):
        # A slope of 1e-308 has no finite inverse, and its harmonic mean with another is then 0, as it should be.
        curve = PchipInterpolator(xi, _rows(waypoints)[kept])
    return Path(curve, float(xi[-1]), peak, longest_ramp_s * peak)


def angles_between(R_a: Float64[np.ndarray, "n 3 3"], R_b: Float64[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n"]:
    """The angle of the rotation that leads from each a to each b, 0 to π."""
    return np.linalg.norm(log_so3(np.swapaxes(R_a, -1, -2) @ R_b), axis=-1)


def _rows(waypoints: Poses) -> Float64[np.ndarray, "m 8"]:
    """Position, quaternion and jaw of each waypoint, the quaternions' signs such that neighbours are near."""
    q = quaternion_from_rotation(waypoints.T_base_tool[:, :3, :3])
    flips = np.where(np.einsum("ni,ni->n", q[1:], q[:-1]) < 0, -1.0, 1.0)
    q = q * np.cumprod(np.append(1.0, flips))[:, None]
    return np.concatenate((waypoints.T_base_tool[:, :3, 3], q, waypoints.jaw_rad[:, None]), axis=1)


def _full_speed_steps(waypoints: Poses, limits: MotionLimits) -> Float64[np.ndarray, "m-1"]:
    R, p = waypoints.T_base_tool[:, :3, :3], waypoints.T_base_tool[:, :3, 3]
    distance = np.linalg.norm(np.diff(p, axis=0), axis=1)
    jaw = np.abs(np.diff(waypoints.jaw_rad))
    turn = angles_between(R[:-1], R[1:])
    return np.max((distance / limits.speed, turn / limits.angular_speed, jaw / limits.jaw_speed), axis=0)
