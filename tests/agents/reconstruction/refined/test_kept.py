"""Arrays that are computed once."""

import numpy as np
import pytest

from agents.reconstruction.refined.cubic import kept


def test_an_array_is_computed_once_and_nobody_writes_into_it():
    asked = []

    @kept
    def squares(count: int) -> np.ndarray:
        asked.append(count)
        return np.arange(count) ** 2

    assert squares(3) is squares(3)
    assert squares(4).tolist() == [0, 1, 4, 9]
    assert asked == [3, 4]
    with pytest.raises(ValueError, match="read-only"):
        squares(3)[0] = 7
