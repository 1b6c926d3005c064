"""How likely the thread stays between the fingers from the capture to the goal.

What is off at the capture is mostly off everywhere: the errors of tool and registration are the same all along a
slide, and only the error of the reconstruction changes along the thread. So a grasp is followed for a fixed set of
errors drawn from one distribution,

    e(s) = c + L(s) ξ(s),   L Lᵀ = Σ(s),   c ~ N(0, Σ_offset + Σ_tool),

with ξ a Gauss-Markov sequence, E ξ(s) ξ(s')ᵀ = exp(−|s − s'| length / ℓ) I: two places farther apart than ℓ are wrong
independently. The share of those captured at s_i that lie within the opening of the slide at every sample from s_i to
the goal is the probability of keeping the thread. The draws are the same for all captures, ways and plans, so what is
compared differs by geometry alone, and a plan is repeated exactly.
"""

import functools

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.config import PlannerConfig
from agents.planner.errors import Offset, tool_covariance
from agents.planner.wedge import within_wedge

DRAWS, SEED = 256, 20251122
TINY_M2 = 1e-18


def drawn_errors(
    covariance: Float64[np.ndarray, "n 3 3"], offset: Offset, step_m: float, config: PlannerConfig
) -> Float64[np.ndarray, "m n 3"]:
    """Where the thread is, less where it is taken to be as the fingers see it, for each draw at each sample.

    Args:
        step_m: the way along the thread from one sample to the next.
    """
    common, along = _normals(len(covariance))
    constant = common @ _root(offset.covariance + tool_covariance(config)).T
    kept = np.exp(-step_m / config.correlation_m)
    field = along.copy()
    for k in range(1, len(covariance)):
        field[:, k] = kept * field[:, k - 1] + np.sqrt(1.0 - kept**2) * along[:, k]
    return constant[:, None] + np.einsum("nij,mnj->mni", _root(covariance), field)


def keep_probability(
    errors: Float64[np.ndarray, "m n 3"],
    R_camera_tool: Float64[np.ndarray, "w n 3 3"],
    goal: int,
    config: PlannerConfig,
) -> Float64[np.ndarray, "w n"]:
    """That a thread captured at each sample is still between the fingers at the goal; 1 at the goal itself."""
    plane = np.einsum("mni,wnij->wmnj", errors, R_camera_tool[..., 1:], optimize=True)
    y, z = plane[..., 0], plane[..., 1] + config.setback_m
    captured = within_wedge(y, z, np.radians(config.open_deg))
    kept = _to_goal(within_wedge(y, z, np.radians(config.slide_deg), config.give_m), goal)
    share = (captured & kept).sum(axis=1) / np.maximum(captured.sum(axis=1), 1)
    share[:, goal] = 1.0
    return share


def _to_goal(holds: Bool[np.ndarray, "w m n"], goal: int) -> Bool[np.ndarray, "w m n"]:
    after = np.logical_and.accumulate(holds[..., goal:], axis=-1)
    before = np.logical_and.accumulate(holds[..., goal::-1], axis=-1)[..., ::-1]
    return np.concatenate((before[..., :-1], after), axis=-1)


@functools.cache
def _normals(n: int) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m n 3"]]:
    """Each with its opposite, so that what is symmetric stays so."""
    rng = np.random.default_rng(SEED)
    common, along = rng.standard_normal((DRAWS // 2, 3)), rng.standard_normal((DRAWS // 2, n, 3))
    return np.concatenate((common, -common)), np.concatenate((along, -along))


def _root(covariance: Float64[np.ndarray, "*n 3 3"]) -> Float64[np.ndarray, "*n 3 3"]:
    """The symmetric root, which rounding of what is singular does no harm."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    return (vectors * np.sqrt(np.maximum(values, TINY_M2))[..., None, :]) @ np.swapaxes(vectors, -1, -2)
