"""How long a strand is, and how well that is known.

A strand is p₁ … pₙ, close together, each with a covariance Σᵢ. Its length ℓ = Σ |pᵢ₊₁ − pᵢ| changes with its points by

    ∂ℓ/∂pᵢ = tᵢ₋₁ − tᵢ,      t the unit vectors from each point to the next, 0 before the first and after the last,

which is ± t at both ends and the bend between them: an error that moves a straight stretch as a whole leaves its
length, one of an end along the strand counts in full. Errors of a reconstruction go together along the thread over λ,
so that

    σ² = Σᵢⱼ (∂ℓ/∂pᵢ)ᵀ Σᵢ^½ ρᵢⱼ Σⱼ^½ (∂ℓ/∂pⱼ) + b² + 2 e²,      ρᵢⱼ = exp(−½ (aᵢ − aⱼ)² / λ²),

a being the way along the strand. To second order errors across the strand lengthen it by ½ ∫ |d/da Pδ|² da, with P
across the strand, which has the mean square

    b² = (½ ∫ tr(PΣP) / λ² da)² + ⅜ √π ∫ tr((PΣP)²) / λ³ da,

and is not taken off, since a smooth curve may be too short as well as too long by it. And each end is seen where the
last point of a centreline is, which is e off at the most.
"""

import numpy as np
from jaxtyping import Float64

from schemas.messages import TailLength

TINY_M2 = 1e-18


def tail_length(
    points: Float64[np.ndarray, "n 3"],
    covariance: Float64[np.ndarray, "n 3 3"],
    correlation_m: float,
    end_m: float = 0.0,
    at_least: bool = False,
) -> TailLength:
    """The length of a strand through these points, in metres, with its standard deviation.

    Args:
        points, covariance: in one frame, dense enough for how the strand bends.
        correlation_m: λ; end_m: e.
        at_least: the strand may go on beyond what is seen of it.
    """
    steps = np.diff(points, axis=0)
    way = np.linalg.norm(steps, axis=1)
    if len(points) < 2 or not way.sum() > 0:
        return TailLength(0.0, np.sqrt(2.0) * end_m, at_least)
    kept = np.append(True, way > 0)
    points, covariance, way = points[kept], covariance[kept], way[way > 0]
    tangents = np.diff(points, axis=0) / way[:, None]
    along = np.append(0.0, np.cumsum(way))
    none = np.zeros((1, 3))
    gradient = np.concatenate((none, tangents)) - np.concatenate((tangents, none))
    weighed = np.einsum("nij,nj->ni", _root(covariance), gradient)
    together = np.exp(-0.5 * ((along[:, None] - along) / correlation_m) ** 2)
    variance = float(np.einsum("ni,nm,mi->", weighed, together, weighed))
    across = _across(covariance, tangents)
    mean_m = 0.5 * float(np.trapezoid(np.trace(across, axis1=1, axis2=2), along)) / correlation_m**2
    squares = np.trapezoid((across**2).sum(axis=(1, 2)), along)
    bulge_m2 = mean_m**2 + 0.375 * np.sqrt(np.pi) * float(squares) / correlation_m**3
    deviation_m = float(np.sqrt(max(variance, 0.0) + bulge_m2 + 2.0 * end_m**2))
    return TailLength(float(along[-1]), deviation_m, at_least)


def _across(
    covariance: Float64[np.ndarray, "n 3 3"], tangents: Float64[np.ndarray, "m 3"]
) -> Float64[np.ndarray, "n 3 3"]:
    """PΣP at each point."""
    here = np.concatenate((tangents, tangents[-1:]))
    P = np.eye(3) - here[:, :, None] * here[:, None, :]
    return P @ covariance @ P


def _root(covariance: Float64[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n 3 3"]:
    values, vectors = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    return (vectors * np.sqrt(np.maximum(values, TINY_M2))[..., None, :]) @ np.swapaxes(vectors, -1, -2)
