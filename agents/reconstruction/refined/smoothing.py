"""How smooth the thread is, from the images themselves.

The weight λ of the minimum-variation objective is the one under which the images are most probable once the curve is
integrated out (marginal likelihood). With H the data's Gauss-Newton matrix, A that of the objective, of rank k:

    log p(images | λ) = ½ k log λ − ½ log |H + λA| − ½ min_δ (data + λ roughness) + constant.

A thread is not equally bent everywhere. So each span then has a weight of its own, λ_k = λ w_k, by MacKay's fixed point
over a window of spans: the number of well-determined third differences there over their sum of squares. What the
images do not determine (depth along the rows) is thereby as rough as what they do show nearby.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.near_inverse import near_inverse
from agents.reconstruction.refined.normal_equations import (
    Blocks,
    band,
    factored_band,
    gradient,
    roughness_blocks,
    solved,
    third_differences,
)
from agents.reconstruction.refined.projection import DEGREE, Curve

COARSE = 10.0 ** np.arange(-1.0, 10.0, 2.0)
FINE = 10.0 ** np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
WINDOW_SPANS = 2.0
PRIOR_COUNT = 1.0
LEAST_WEIGHT, MOST_WEIGHT = 0.1, 50.0


def chosen_smoothing(
    curve: Curve, data: Blocks, weight: Float64[np.ndarray, "spans"], candidates: Float64[np.ndarray, "c"]
) -> float:
    """The candidate λ with the greatest marginal likelihood."""
    evidence = log_evidence(curve, data, roughness_blocks(curve, weight))
    return float(max(candidates, key=lambda smoothing: evidence(float(smoothing))))


def log_evidence(curve: Curve, data: Blocks, unit: Blocks) -> Callable[[float], float]:
    """log p(images | λ) up to a constant, as a function of λ; `data` includes what damps motion along the curve."""
    bands, gradients = [band(blocks) for blocks in (data, unit)], [gradient(blocks.g) for blocks in (data, unit)]
    roughness = 0.5 * float(curve.control_points.ravel() @ gradients[1])

    def of(smoothing: float) -> float:
        try:
            factor = factored_band(bands[0] + smoothing * bands[1])
        except np.linalg.LinAlgError:
            return -np.inf
        g = gradients[0] + smoothing * gradients[1]
        energy = smoothing * roughness - 0.5 * float(g @ solved(factor, g))
        return 1.5 * curve.spans * np.log(smoothing) - float(np.log(factor[0]).sum()) - energy

    return of


def local_weights(
    curve: Curve, total: Blocks, smoothing: float, weight: Float64[np.ndarray, "spans"]
) -> Float64[np.ndarray, "spans"]:
    """How much smoother than on the whole each span is; `total` is with the present weights."""
    third = third_differences(curve.spans) / curve.size
    bend = ((third @ curve.control_points) ** 2).sum(axis=1)
    variance = _variance(third, near_inverse(total))
    determined = np.clip(3.0 - smoothing * weight * variance, 0.0, 3.0)
    k = np.arange(curve.spans)
    window = np.exp(-0.5 * ((k[:, None] - k) / WINDOW_SPANS) ** 2)
    found = (window @ determined + PRIOR_COUNT) / (window @ (smoothing * bend) + PRIOR_COUNT)
    return np.clip(found, LEAST_WEIGHT, MOST_WEIGHT)


def _variance(
    third: Float64[np.ndarray, "spans m"], covariance: Float64[np.ndarray, "spans 12 12"]
) -> Float64[np.ndarray, "spans"]:
    """Of each third difference, all directions in space together, from the covariance of each span's control points."""
    near = np.arange(len(third))[:, None] + np.arange(DEGREE + 1)
    local = np.take_along_axis(third, near, axis=1)
    in_space = np.einsum("kiaja->kij", covariance.reshape(-1, DEGREE + 1, 3, DEGREE + 1, 3))
    return np.einsum("ki,kij,kj->k", local, in_space, local)
