"""The covariance near the diagonal against the dense inverse."""

import numpy as np
import pytest

from agents.reconstruction.refined.near_inverse import near_inverse
from agents.reconstruction.refined.normal_equations import Blocks


def blocks_of(spans):
    """A definite matrix in blocks, and the same as a dense one."""
    rows = np.random.default_rng(spans).normal(size=(spans, 30, 12)) * np.geomspace(1e-2, 1e2, 12)
    H = rows.transpose(0, 2, 1) @ rows
    dense = np.zeros((3 * spans + 9, 3 * spans + 9))
    for k, block in enumerate(H):
        dense[3 * k : 3 * k + 12, 3 * k : 3 * k + 12] += block
    return Blocks(H, np.zeros((spans, 12))), dense


@pytest.mark.parametrize("spans", [1, 2, 3, 4, 9, 10, 40])
def test_what_concerns_each_span_is_that_of_the_whole_inverse(spans):
    blocks, dense = blocks_of(spans)
    whole = np.linalg.inv(dense)
    for k, found in enumerate(near_inverse(blocks)):
        wanted = whole[3 * k : 3 * k + 12, 3 * k : 3 * k + 12]
        size = np.sqrt(np.diag(wanted))
        np.testing.assert_allclose(found / np.outer(size, size), wanted / np.outer(size, size), atol=1e-9)


@pytest.mark.parametrize("place", [0, 20, 39])
def test_a_matrix_that_is_not_definite_is_told(place):
    blocks, _ = blocks_of(40)
    blocks.H[place] *= -10.0
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        near_inverse(blocks)
