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
difference; a slant by α moves it by 1 mm tan α, which counts as a deviation of its own (`errors.py`).
"""

import numpy as np
from jaxtyping import Float64
from scipy.special import ndtr

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
