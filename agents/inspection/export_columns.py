"""Columns of exported tables, and how single values become columns."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from shared.rigid_transforms import quaternion_from_rotation

Column = np.ndarray | list[str]
Block = Mapping[str, Column]
"""Columns of equal length, in their order."""
AXES = ("x", "y", "z")


def pose(of: str, frame: str, T: Float64[np.ndarray, "n 4 4"]) -> Block:
    """The poses of a tool in a frame: position in metres and unit quaternion, scalar part first."""
    q_wxyz = quaternion_from_rotation(T[:, :3, :3])
    rows: dict[str, Column] = {f"{of}_{axis}_{frame}_m": T[:, i, 3] for i, axis in enumerate(AXES)}
    return rows | {f"{of}_q{part}_{frame}": q_wxyz[:, i] for i, part in enumerate("wxyz")}


def whole(value: int) -> np.ndarray:
    """A whole number as a column."""
    return np.array([value], np.int64)


def number(value: float | None) -> np.ndarray:
    """A number as a column; NaN for none."""
    return np.array([np.nan if value is None else value], np.float64)


def seconds(at_ns: int, zero_ns: int) -> np.ndarray:
    """A time as a column, in seconds since time zero."""
    return np.array([(at_ns - zero_ns) * 1e-9])


def row_count(block: Block) -> int:
    """How many rows a block has."""
    return len(next(iter(block.values())))
