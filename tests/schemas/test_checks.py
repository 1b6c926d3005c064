import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from jaxtyping import Bool, Float64

from schemas.checks import MessageError, check_message


@dataclasses.dataclass(frozen=True)
class Sample:
    points: Float64[np.ndarray, "n 3"]
    weight: Float64[np.ndarray, "n"]
    kept: Bool[np.ndarray, "n"]
    scale: float
    unit: float | None

    def __post_init__(self):
        check_message(self)


def sample(**changes):
    values: dict[str, Any] = {"points": np.zeros((4, 3)), "weight": np.ones(4), "kept": np.ones(4, dtype=bool)}
    values |= {"scale": 2.0, "unit": None}
    return Sample(**(values | changes))


REFUSED = [
    ({"scale": None}, r"Sample\.scale is missing"),
    ({"weight": [1.0] * 4}, r"Sample\.weight must be a NumPy array, not list"),
    ({"weight": np.ones(4, np.float32)}, r"weight must hold float64, not float32"),
    ({"kept": np.ones(4)}, r"kept must hold bool, not float64"),
    ({"points": np.zeros(12)}, r"points must have shape \(n, 3\), not \(12,\)"),
    ({"points": np.zeros((4, 2))}, r"points has shape \(4, 2\) where \(n, 3\) needs 3 = 3"),
    ({"weight": np.ones(5)}, r"weight has shape \(5,\) where \(n\) needs n = 4"),
    ({"weight": np.array([1, np.nan, 1, 1])}, r"weight must be finite"),
    ({"scale": math.nan}, r"Sample\.scale must be a finite number, not nan"),
    ({"unit": math.inf}, r"Sample\.unit must be a finite number, not inf"),
    ({"scale": "2"}, r"Sample\.scale must be a finite number, not '2'"),
]


@pytest.mark.parametrize(("changes", "text"), REFUSED)
def test_what_does_not_fit_its_annotation_is_refused_by_name(changes, text):
    with pytest.raises(MessageError, match=text):
        sample(**changes)


def test_a_message_is_frozen_and_its_arrays_are_read_only_views():
    mine = np.zeros((3, 4))
    made = sample(points=mine.T, unit=1e-3)
    assert made.points.flags.c_contiguous
    for array in (made.points, made.weight, made.kept):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.__setattr__("scale", 3.0)
    mine[0] = 1
    assert mine[0, 0] == 1
