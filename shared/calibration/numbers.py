"""Numbers and matrices out of parsed documents; `name` is what the file calls them, for the error's text."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from shared.calibration.documents import Node
from shared.calibration.stated import CalibrationError

_LARGEST = 1e9
"""No focal length, coefficient or distance is larger in any unit."""


def array(node: Node, name: str) -> Float64[np.ndarray, "..."]:
    """The numbers of a nested list, of a `rows`, `cols`, `data` mapping as OpenCV and ROS write it, or a lone one.

    Raises:
        CalibrationError: where something is not a finite number, or numbers are missing.
    """
    if not isinstance(node, Mapping):
        return _finite(node, name)
    if "data" not in node:
        raise CalibrationError(f"{name} holds no data")
    values = _finite(node["data"], name)
    if "rows" not in node or "cols" not in node:
        return values
    rows, cols = whole_number(node["rows"], f"rows of {name}"), whole_number(node["cols"], f"cols of {name}")
    if values.size != rows * cols:
        raise CalibrationError(f"{name} has {values.size} numbers where {rows} rows of {cols} need {rows * cols}")
    return values.reshape(rows, cols)


def matrix(node: Node, name: str, rows: int, cols: int) -> Float64[np.ndarray, "rows cols"]:
    """A matrix of that shape; a flat list of as many numbers is taken row by row.

    Raises:
        CalibrationError: where it has another shape.
    """
    values = array(node, name)
    if values.shape != (rows, cols) and values.shape not in ((rows * cols,), (1, rows * cols), (rows * cols, 1)):
        raise CalibrationError(f"{name} must be {rows}x{cols}, but is {shape_text(values)}")
    return values.reshape(rows, cols)


def vector(node: Node, name: str) -> Float64[np.ndarray, "n"]:
    """Numbers in one row or one column, or none at all.

    Raises:
        CalibrationError: where they form a matrix.
    """
    values = array(node, name)
    if max(values.shape, default=1) != values.size:
        raise CalibrationError(f"{name} must be one row of numbers, but is {shape_text(values)}")
    return values.reshape(-1)


def whole_number(node: Node, name: str) -> int:
    """A positive whole number, also where it is written as 640.0.

    Raises:
        CalibrationError: where it is anything else.
    """
    values = array(node, name)
    if values.size != 1 or values.item() <= 0 or values.item() != int(values.item()):
        raise CalibrationError(f"{name} must be one positive whole number")
    return int(values.item())


def shape_text(values: np.ndarray) -> str:
    """A shape as people say it: `3x4`, `5 numbers`, `one number`."""
    if values.size == 1:
        return "one number"
    return f"{values.size} numbers" if values.ndim == 1 else "x".join(map(str, values.shape))


def _finite(node: Node, name: str) -> Float64[np.ndarray, "..."]:
    try:
        values = np.array(node, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        raise CalibrationError(f"{name} does not hold numbers only, in rows of equal length") from None
    if not np.isfinite(values).all():
        raise CalibrationError(f"{name} holds something that is not a finite number")
    if values.size and np.abs(values).max() > _LARGEST:
        raise CalibrationError(f"{name} holds a number beyond {_LARGEST:.0e}, which no calibration does")
    return values
