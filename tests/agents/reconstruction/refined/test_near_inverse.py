"""The covariance near the diagonal against the dense inverse."""

import numpy as np
import pytest

from agents.reconstruction.refined.near_inverse import near_inverse
from agents.reconstruction.refined.normal_equations import Blocks


@pytest.mark.parametrize("spans", [1, 2, 4, 9, 40])
def test_what_concerns_each_span_is_that_of_the_whole_inverse_and_indefinite_is_told(spans, dense):
    rows = np.random.default_rng(spans).normal(size=(spans, 30, 12)) * np.geomspace(1e-2, 1e2, 12)
    blocks = Blocks(rows.transpose(0, 2, 1) @ rows, np.zeros((spans, 12)))
    whole = np.linalg.inv(dense(blocks.H))
    for k, found in enumerate(near_inverse(blocks)):
        wanted = whole[3 * k : 3 * k + 12, 3 * k : 3 * k + 12]
        size = np.sqrt(np.diag(wanted))
        np.testing.assert_allclose(found / np.outer(size, size), wanted / np.outer(size, size), atol=1e-9)
    blocks.H[spans // 2] *= -10.0
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        near_inverse(blocks)
