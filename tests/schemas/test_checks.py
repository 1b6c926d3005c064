import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import Bool, Float64

from schemas.checks import MessageError, check_message, fields_of, is_array, require, without_none


@dataclasses.dataclass(frozen=True)
class Sample:
    points: Float64[np.ndarray, "n 3"]
    weight: Float64[np.ndarray, "n"]
    kept: Bool[np.ndarray, "n"]
    scale: float
    unit: float | None
    name: str

    def __post_init__(self):
        check_message(self)


def sample(**changes):
    values: dict[str, Any] = {
        "points": np.zeros((4, 3)),
        "weight": np.ones(4),
        "kept": np.ones(4, dtype=bool),
        "scale": 2.0,
        "unit": None,
        "name": "a",
    }
    return Sample(**(values | changes))


REFUSED = {
    "a missing value": ({"scale": None}, r"Sample\.scale is missing"),
    "a list": ({"weight": [1.0] * 4}, r"Sample\.weight must be a NumPy array, not list"),
    "single precision": ({"weight": np.ones(4, np.float32)}, r"weight must hold float64, not float32"),
    "numbers for booleans": ({"kept": np.ones(4)}, r"kept must hold bool, not float64"),
    "too few axes": ({"points": np.zeros(12)}, r"points must have shape \(n, 3\), not \(12,\)"),
    "a wrong fixed axis": ({"points": np.zeros((4, 2))}, r"points has shape \(4, 2\) where \(n, 3\) needs 3 = 3"),
    "another length of a shared axis": ({"weight": np.ones(5)}, r"weight has shape \(5,\) where \(n\) needs n = 4"),
    "a NaN in an array": ({"weight": np.array([1, np.nan, 1, 1])}, r"weight must be finite"),
    "a NaN": ({"scale": math.nan}, r"Sample\.scale must be a finite number, not nan"),
    "an infinite optional": ({"unit": math.inf}, r"Sample\.unit must be a finite number, not inf"),
    "text for a number": ({"scale": "2"}, r"Sample\.scale must be a finite number, not '2'"),
}


@pytest.mark.parametrize(("changes", "text"), REFUSED.values(), ids=REFUSED)
def test_a_message_is_refused_with(changes, text):
    with pytest.raises(MessageError, match=text):
        sample(**changes)


@given(n=st.integers(0, 20), unit=st.none() | st.just(1e-3))
def test_any_length_of_a_named_axis_is_good_where_all_agree(n, unit):
    made = sample(points=np.zeros((n, 3)), weight=np.ones(n), kept=np.ones(n, bool), unit=unit)
    assert made.points.shape == (n, 3)
    assert made.unit == unit


def test_a_message_is_frozen_and_its_arrays_are_read_only_views():
    mine = np.zeros((3, 4))
    made = sample(points=mine.T)
    assert made.points.flags.c_contiguous
    for array in (made.points, made.weight, made.kept):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.__setattr__("scale", 3.0)
    mine[0] = 1
    assert mine[0, 0] == 1


def test_fields_come_in_order_with_their_annotations():
    fields = fields_of(Sample)
    assert list(fields) == ["points", "weight", "kept", "scale", "unit", "name"]
    assert [name for name, annotation in fields.items() if is_array(annotation)] == ["points", "weight", "kept"]
    assert without_none(float | None) is float
    assert without_none(tuple[int, ...]) == tuple[int, ...]


def test_require_raises_its_text_unless_the_condition_holds():
    require(True, "never")
    with pytest.raises(MessageError, match=r"^just so$"):
        require(False, "just so")
