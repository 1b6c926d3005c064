"""A smooth way through poses, from rest to rest, whose jerk has a bound.

Position, quaternion and jaw angle run through the waypoints as monotone cubics (PCHIP; Fritsch and Carlson, SIAM J.
Numer. Anal. 17, 1980), never outside the box that two neighbours span, so the tool does not swing out behind a
waypoint. Their parameter ξ is the time that the way would take at full speed,

    ξ = Σ max(|Δp| / v, |Δangle| / ω, |Δjaw| / j),

and a quaternion between two waypoints is normalised, which keeps it on the great arc of slerp.

In time, ξ's rate rises from rest to its peak r along the smoothstep 3x² - 2x³ within t_r, stays there, and falls
likewise. Its slope is at most 1.5 r / t_r and its second derivative 6 r / t_r². With A the least of all a / v and J
the least of all j / v, both are kept to by

    t_r = max(1.5 r / A, √(6 r / J)),    r = 1 where ξ ≥ t_r(1), else r = ξ / t_r, t_r = max(√(1.5 ξ / A), ∛(6 ξ / J)).

A cubic's second derivative jumps at waypoints. So what is followed is the mean over the last t_m = `rounding_s`, by
which a jump Δa becomes a ramp of jerk Δa / t_m: straight lines and both ends stay as they are, and a bend is cut by
Δa t_m² / 8 at most, a tenth of a millimetre or so. Cubics run faster than their chords in places; the caller looks
at the samples and slows the path down.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import uniform_filter1d

from agents.robot_bridge.limits import MotionLimits
from shared.rigid_transforms import angle_between, quaternion_from_rotation, rotation_from_quaternion, transform

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
        rounding_s: over how long the mean is taken.
    """

    curve: PchipInterpolator
    xi_end: float
    peak: float
    ramp_s: float
    rounding_s: float

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self._cubic_s + self.rounding_s

    @property
    def _cubic_s(self) -> float:
        return self.xi_end / self.peak + self.ramp_s

    def sample(self, period_s: float, slowing: float = 1.0) -> Poses:
        """The poses of every tick from start to end when each moment lasts `slowing` times as long."""
        ticks = np.arange(np.ceil(self._cubic_s * slowing / period_s) + 1)
        rows = self.curve(self._travelled(np.minimum(ticks * (period_s / slowing), self._cubic_s)))
        rows = _mean_of_the_last(rows, int(np.ceil(self.rounding_s * slowing / period_s)))
        return Poses(transform(rotation_from_quaternion(rows[:, 3:7]), rows[:, :3]), rows[:, 7])

    def _travelled(self, t: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
        """ξ at each time: the rate's integral, which is the same seen from either end."""
        from_nearer_end = np.minimum(t, self._cubic_s - t)
        x = np.clip(from_nearer_end / self.ramp_s, 0, 1)
        near = self.peak * (self.ramp_s * (x**3 - x**4 / 2) + np.maximum(from_nearer_end - self.ramp_s, 0))
        return np.where(t > self._cubic_s / 2, self.xi_end - near, near)


def smooth_path(waypoints: Poses, limits: MotionLimits, share: float) -> Path | None:
    """The way through poses at a share of full speed; None where they are all the same."""
    steps = _full_speed_steps(waypoints, limits) / share
    kept = np.append(True, steps > _NO_WAY_S)
    xi = np.append(0.0, np.cumsum(steps[kept[1:]]))
    if len(xi) == 1:
        return None
    with np.errstate(over="ignore"):
        # A slope of 1e-308 has no finite inverse, and its harmonic mean with another is then 0, as it should be.
        curve = PchipInterpolator(xi, _rows(waypoints)[kept])
    return Path(curve, float(xi[-1]), *_peak_and_ramp(float(xi[-1]), limits), limits.rounding_s)


def _peak_and_ramp(xi_end: float, limits: MotionLimits) -> tuple[float, float]:
    """The peak of ξ's rate, and how long it takes to get there."""
    speeds = np.array((limits.speed, limits.angular_speed, limits.jaw_speed))
    per_s = 1.5 * (speeds / (limits.acceleration, limits.angular_acceleration, limits.jaw_acceleration)).max()
    per_s2 = 6.0 * (speeds / (limits.jerk, limits.angular_jerk, limits.jaw_jerk)).max()
    longest_s = float(max(per_s, np.sqrt(per_s2)))
    if xi_end >= longest_s:
        return 1.0, longest_s
    ramp_s = float(max(np.sqrt(per_s * xi_end), np.cbrt(per_s2 * xi_end)))
    return xi_end / ramp_s, ramp_s


def _mean_of_the_last(rows: Float64[np.ndarray, "n 8"], count: int) -> Float64[np.ndarray, "m 8"]:
    """The mean of each row and the `count` - 1 before it, at rest before the first and after the last."""
    if count < 2:
        return rows
    padded = np.pad(rows, ((count - 1, count - 1), (0, 0)), mode="edge")
    mean = uniform_filter1d(padded, count, axis=0)[count // 2 :][: len(rows) + count - 1]
    mean[[0, -1]] = rows[[0, -1]]
    return mean


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
    turn = angle_between(R[:-1], R[1:])
    return np.max((distance / limits.speed, turn / limits.angular_speed, jaw / limits.jaw_speed), axis=0)
