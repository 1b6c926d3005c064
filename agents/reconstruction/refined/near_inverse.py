"""The covariance of control points that lie near each other, without that of all others.

H couples control points up to three apart, so in groups of several it is block-tridiagonal, with D_i on the diagonal
and B_i beside it. With P_i = D_i − B_{i−1}ᵀ P_{i−1}⁻¹ B_{i−1} and G_i = P_i⁻¹ B_i, the blocks of S = H⁻¹ follow
from the last one backwards (Takahashi, Fagan and Chin 1973):

    S_n = P_n⁻¹,   S_{i,i+1} = −G_i S_{i+1},   S_i = P_i⁻¹ − S_{i,i+1} G_iᵀ.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.refined.normal_equations import SIDE, Blocks, band, factored

GROUP = 18
"""Rows of a group, six control points: fewer take more steps, more take longer ones."""


def near_inverse(blocks: Blocks) -> Float64[np.ndarray, "spans 12 12"]:
    """Of H⁻¹, what concerns the control points of each span.

    Raises:
        numpy.linalg.LinAlgError: where H is not positive definite.
    """
    # which tells whether H is positive definite
    factored(blocks)
    H, groups = _in_groups(band(blocks))
    inside, ahead = [np.linalg.inv(H[groups[0], groups[0]])], []
    for before, here in pairwise(groups):
        beside = H[before, here]
        ahead.append(inside[-1] @ beside)
        inside.append(np.linalg.inv(H[here, here] - beside.T @ ahead[-1]))
    return _by_span(_backwards(inside, ahead, groups), len(blocks.H))


def _backwards(
    inside: list[Float64[np.ndarray, "g g"]], ahead: list[Float64[np.ndarray, "g g"]], groups: list[slice]
) -> Float64[np.ndarray, "w w"]:
    """S in and beside the diagonal; what lies farther away is left at 0."""
    S = np.zeros((groups[-1].stop, groups[-1].stop))
    last = S[groups[-1], groups[-1]] = inside[-1]
    for i in reversed(range(len(groups) - 1)):
        beside = -ahead[i] @ last
        last = inside[i] - beside @ ahead[i].T
        last = 0.5 * (last + last.T)
        S[groups[i], groups[i]] = last
        S[groups[i], groups[i + 1]] = beside
        S[groups[i + 1], groups[i]] = beside.T
    return S


def _in_groups(lower: Float64[np.ndarray, "12 v"]) -> tuple[Float64[np.ndarray, "w w"], list[slice]]:
    """H from its lower band, filled up with ones to whole groups, and the rows of each group."""
    size = lower.shape[1]
    count = -(-size // GROUP)
    H = np.eye(count * GROUP)
    flat, step = H.ravel(), count * GROUP + 1
    flat[: size * step : step] = lower[0]
    for offset in range(1, SIDE):
        values = lower[offset, : size - offset]
        flat[offset : (size - offset) * step : step][: size - offset] = values
        flat[offset * (step - 1) :: step][: size - offset] = values
    return H, [slice(i * GROUP, (i + 1) * GROUP) for i in range(count)]


def _by_span(S: Float64[np.ndarray, "w w"], spans: int) -> Float64[np.ndarray, "spans 12 12"]:
    """The blocks of each span's control points, which overlap."""
    row, column = S.strides
    windows = np.lib.stride_tricks.as_strided(S, (spans, SIDE, SIDE), (3 * (row + column), row, column))
    return windows.copy()
