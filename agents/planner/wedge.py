"""How likely a thread lies in the space that closing fingers sweep.

The fingers hinge at the pin and are ℓ long, so while they close from an opening θ they sweep, in the plane across the
pin (y the way they open, z along them when closed), the wedge

    √(y² + z²) ≤ ℓ,   |y| ≤ z tan θ/2,

narrow at the pin and wide at the tips. Where the thread crosses that plane is known as a normal distribution of y and
z; with z ~ N(μ_z, σ_z²) and y given z normal as well,

    P = ∫₀^ℓ φ((z − μ_z) / σ_z) / σ_z · [Φ((w(z) − m(z)) / s) − Φ((−w(z) − m(z)) / s)] dz,

where w(z) is half the width of the wedge, m(z) = μ_y + σ_yz / σ_z² (z − μ_z) and s² = σ_y² − σ_yz² / σ_z². The inner
difference is smooth but for the corner at z = ℓ cos θ/2, so each side of it is integrated by Gauss-Legendre, over what
of it lies within 6 σ_z, before and behind the mean apart.

The thread runs along the pin, and fingers 2 mm wide see it as straight, so how it runs within that width makes no
difference; a slant by α moves it by 1 mm tan α, which counts as a deviation of its own.

**How far the thread may be from where the fingers are taken to be**: three errors add up, independent of each other,
each taken as normal:

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
from scipy.special import ndtr

from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from schemas.messages import ThreadReconstruction
from shared.kinematics.psm import FINGER_M

NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)
FAR_SIGMAS = 6.0
STEEPEST_RAD = 1.55
LEAST_M = 1e-7
"""A deviation: nothing is known better than this, and nothing is divided by zero."""


def wedge_probability(
    mean: Float64[np.ndarray, "*n 2"],
    covariance: Float64[np.ndarray, "*n 2 2"],
    opening_rad: float,
    give_m: float = 0.0,
    length_m: float = FINGER_M,
) -> Float64[np.ndarray, "*n"]:
    """That a thread at N(mean, covariance) of (y, z), in metres, is between fingers of that opening.

    Args:
        give_m: how far the thread may be beyond a finger's face, which it gives way to, and is still between them.
    """
    half = float(np.clip(0.5 * opening_rad, 0.0, 0.5 * np.pi))
    sigma_z = np.maximum(np.sqrt(np.maximum(covariance[..., 1, 1], 0.0)), LEAST_M)
    slope = covariance[..., 0, 1] / sigma_z**2
    rest = np.maximum(np.sqrt(np.maximum(covariance[..., 0, 0] - slope**2 * sigma_z**2, 0.0)), LEAST_M)
    mean_y, mean_z = mean[..., 0], mean[..., 1]
    low, high = mean_z - FAR_SIGMAS * sigma_z, mean_z + FAR_SIGMAS * sigma_z
    corner = _corner(half, give_m, length_m)
    total = np.zeros(mean_y.shape)
    for start, end in ((0.0, corner), (corner, length_m)):
        for side_low, side_high in ((low, mean_z), (mean_z, high)):
            a, b = np.clip(side_low, start, end), np.clip(side_high, start, end)
            if not (b > a).any():
                continue
            z = 0.5 * (a + b)[..., None] + 0.5 * (b - a)[..., None] * NODES
            off = z - mean_z[..., None]
            width = half_width(z, half, give_m, length_m)
            middle = mean_y[..., None] + slope[..., None] * off
            inside = ndtr((width - middle) / rest[..., None]) - ndtr((-width - middle) / rest[..., None])
            density = np.exp(-0.5 * (off / sigma_z[..., None]) ** 2) / (np.sqrt(2.0 * np.pi) * sigma_z[..., None])
            # summed one by one: a product of matrices rounds by how many there are, and of equals one must win
            total += 0.5 * (b - a) * (inside * density * WEIGHTS).sum(axis=-1)
    return np.clip(total, 0.0, 1.0)


def _corner(half_rad: float, give_m: float, length_m: float) -> float:
    """How far from the pin, along the closed fingers, the faces end and the circle of the tips begins."""
    slope, beside = np.tan(min(half_rad, STEEPEST_RAD)), give_m / np.cos(min(half_rad, STEEPEST_RAD))
    return float((np.sqrt((1 + slope**2) * length_m**2 - beside**2) - slope * beside) / (1 + slope**2))


def half_width(
    z: Float64[np.ndarray, "*n"], half_rad: float, give_m: float, length_m: float = FINGER_M
) -> Float64[np.ndarray, "*n"]:
    """Half the width of the wedge at a distance from the pin along the closed fingers; the tips move on a circle."""
    return np.minimum(face_half_width(z, half_rad, give_m), tips_half_width(z, length_m))


def face_half_width(z: Float64[np.ndarray, "*n"], half_rad: float, give_m: float) -> Float64[np.ndarray, "*n"]:
    """The same of faces without an end."""
    return z * np.tan(min(half_rad, STEEPEST_RAD)) + give_m / np.cos(min(half_rad, STEEPEST_RAD))


def tips_half_width(z: Float64[np.ndarray, "*n"], length_m: float = FINGER_M) -> Float64[np.ndarray, "*n"]:
    """The same of the circle on which the tips move."""
    return np.sqrt(np.maximum(length_m**2 - z**2, 0.0))


def within_wedge(
    y: Float64[np.ndarray, "*n"],
    z: Float64[np.ndarray, "*n"],
    opening_rad: float,
    give_m: float = 0.0,
    length_m: float = FINGER_M,
) -> np.ndarray:
    """Whether places lie between fingers of that opening."""
    return (z > 0) & (np.abs(y) <= half_width(z, 0.5 * opening_rad, give_m, length_m))


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
