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
    "a missing array": ({"points": None}, r"Sample\.points is missing"),
    "a list": ({"weight": [1.0] * 4}, r"Sample\.weight must be a NumPy array, not list"),
    "single precision": ({"weight": np.ones(4, np.float32)}, r"weight must hold float64, not float32"),
    "numbers for booleans": ({"kept": np.ones(4)}, r"kept must hold bool, not float64"),
    "too few axes": ({"points": np.zeros(12)}, r"points must have shape \(n, 3\), not \(12,\)"),
    "too many axes": ({"weight": np.ones((4, 1))}, r"weight must have shape \(n\), not \(4, 1\)"),
    "a wrong fixed axis": ({"points": np.zeros((4, 2))}, r"points has shape \(4, 2\) where \(n, 3\) needs 3 = 3"),
    "another length of a shared axis": ({"weight": np.ones(5)}, r"weight has shape \(5,\) where \(n\) needs n = 4"),
    "a NaN in an array": ({"weight": np.array([1, np.nan, 1, 1])}, r"weight must be finite"),
    "an infinity in an array": ({"weight": np.array([1, -np.inf, 1, 1])}, r"weight must be finite"),
    "a NaN": ({"scale": math.nan}, r"Sample\.scale must be a finite number, not nan"),
    "an infinite optional": ({"unit": math.inf}, r"Sample\.unit must be a finite number, not inf"),
    "text for a number": ({"scale": "2"}, r"Sample\.scale must be a finite number, not '2'"),
}


@pytest.mark.parametrize(("changes", "text"), REFUSED.values(), ids=REFUSED)
def test_a_message_is_refused_with(changes, text):
    with pytest.raises(MessageError, match=text):
        sample(**changes)


def test_a_good_message_is_made():
    assert sample(unit=1e-3).unit == 1e-3
    assert sample().unit is None


@given(n=st.integers(0, 20))
def test_any_length_of_a_named_axis_is_good_where_all_agree(n):
    made = sample(points=np.zeros((n, 3)), weight=np.ones(n), kept=np.ones(n, bool))
    assert made.points.shape == (n, 3)


def test_arrays_of_a_message_are_read_only_and_contiguous():
    made = sample(points=np.zeros((3, 4)).T)
    assert made.points.flags.c_contiguous
    for array in (made.points, made.weight, made.kept):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_the_callers_own_array_stays_writeable():
    mine = np.zeros((4, 3))
    sample(points=mine)
    mine[0] = 1
    assert mine[0, 0] == 1


def test_a_message_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        sample().__setattr__("scale", 3.0)


def test_fields_come_in_order_with_their_annotations():
    fields = fields_of(Sample)
    assert list(fields) == ["points", "weight", "kept", "scale", "unit", "name"]
    assert [name for name, annotation in fields.items() if is_array(annotation)] == ["points", "weight", "kept"]


def test_only_an_optional_loses_its_none():
    assert without_none(float | None) is float
    assert without_none(float) is float
    assert without_none(tuple[int, ...]) == tuple[int, ...]


def test_require_raises_its_text_unless_the_condition_holds():
    require(True, "never")
    with pytest.raises(MessageError, match=r"^just so$"):
        require(False, "just so")
