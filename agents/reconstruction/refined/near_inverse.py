"""The covariance of control points that lie near each other, without that of all others.

H couples control points up to three apart, so in groups of several its Cholesky factor has blocks on the diagonal, L_i,
and one below each, M_i. With G_i = M_i L_i⁻¹ the blocks of S = H⁻¹ follow from the last one backwards (Takahashi, Fagan
and Chin 1973):

    S_n = L_n⁻ᵀ L_n⁻¹,   S_{i+1,i} = −S_{i+1} G_i,   S_i = L_i⁻ᵀ L_i⁻¹ − G_iᵀ S_{i+1,i}.
"""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import lapack

from agents.reconstruction.refined.normal_equations import SIDE, Blocks, factored
from agents.reconstruction.refined.projection import kept

GROUP = 18
"""Rows of a group, six control points: fewer take more steps, more take longer ones."""


def near_inverse(blocks: Blocks) -> Float64[np.ndarray, "spans 12 12"]:
    """Of H⁻¹, what concerns the control points of each span.

    Raises:
        numpy.linalg.LinAlgError: where H is not positive definite.
    """
    inside, below = _in_groups(factored(blocks))
    inverse = np.stack([lapack.dtrtri(group, lower=1)[0] for group in inside])
    ahead, S = below[:-1] @ inverse[:-1], inverse.transpose(0, 2, 1) @ inverse
    beside = np.zeros_like(S)
    for i in reversed(range(len(S) - 1)):
        beside[i] = -S[i + 1] @ ahead[i]
        S[i] -= ahead[i].T @ beside[i]
    return _by_span(0.5 * (S + S.transpose(0, 2, 1)), beside, len(blocks.H))


def _in_groups(
    factor: Float64[np.ndarray, "12 v"],
) -> tuple[Float64[np.ndarray, "g r r"], Float64[np.ndarray, "g r r"]]:
    """The blocks of the factor, filled up with ones on the diagonal to whole groups."""
    numbers = np.append(factor, (0.0, 1.0))
    inside, below = numbers[_group_index(factor.shape[1])]
    return inside, below


@kept
def _group_index(size: int) -> Int64[np.ndarray, "2 g r r"]:
    """Where each number of the blocks lies in the band, behind which are a zero and a one."""
    count = -(-size // GROUP)
    column = GROUP * np.arange(count)[:, None, None] + np.arange(GROUP)
    row = GROUP * np.arange(count)[:, None, None] + np.arange(2 * GROUP)[:, None]
    apart = row - column
    known = (apart >= 0) & (apart < SIDE) & (row < size)
    filled = np.where((apart == 0) & (row >= size), SIDE * size + 1, SIDE * size)
    index = np.where(known, apart * size + column, filled)
    return np.stack((index[:, :GROUP], index[:, GROUP:]))


def _by_span(
    S: Float64[np.ndarray, "g r r"], beside: Float64[np.ndarray, "g r r"], spans: int
) -> Float64[np.ndarray, "spans 12 12"]:
    """The blocks of each span's control points, which overlap: those that begin in a group end in the next one."""
    pairs = np.zeros((len(S), 2 * GROUP, 2 * GROUP))
    pairs[:, :GROUP, :GROUP], pairs[:-1, GROUP:, GROUP:] = S, S[1:]
    pairs[:, GROUP:, :GROUP], pairs[:, :GROUP, GROUP:] = beside, beside.transpose(0, 2, 1)
    group, row, column = pairs.strides
    shape, steps = (len(S), GROUP // 3, SIDE, SIDE), (group, 3 * (row + column), row, column)
    return np.lib.stride_tricks.as_strided(pairs, shape, steps).reshape(-1, SIDE, SIDE)[:spans]
