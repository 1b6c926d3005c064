"""Boxes that hold everything that is to be looked at, and little else: few where it is compact, more where it winds."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

CONTEXT_PX = 8
"""Around a box that is looked at too. What is looked for lies far from the border of where it is looked for already."""
MULTIPLE_PX = 16
"""Of which the outer sides are, and where they begin, wherever the image allows it."""
WORTH_SHARE = 0.95
"""Of the area of one box: two are worth their while where they have less."""
SMALLEST_PX = 64
"""Boxes of this side and less are not divided."""


@dataclass(frozen=True)
class Box:
    """A box of pixels, and the larger one that is looked at for it.

    Fields:
        inner, outer: rows and columns.
    """

    inner: tuple[slice, slice]
    outer: tuple[slice, slice]

    @property
    def inner_in_outer(self) -> tuple[slice, slice]:
        """The inner box, counted from where the outer begins."""
        rows, columns = (
            slice(inner.start - outer.start, inner.stop - outer.start)
            for inner, outer in zip(self.inner, self.outer, strict=True)
        )
        return rows, columns

    @property
    def area(self) -> int:
        """Pixels that are looked at."""
        rows, columns = (side.stop - side.start for side in self.outer)
        return rows * columns


def boxes_around(where: Bool[np.ndarray, "h w"]) -> list[Box]:
    """Boxes without common inner pixels that hold every pixel that is set."""
    return _boxes(where, 0, 0)


def _boxes(where: Bool[np.ndarray, "h w"], top: int, left: int, shape: tuple[int, ...] | None = None) -> list[Box]:
    shape = shape or where.shape
    rows, columns = (np.flatnonzero(where.any(axis=1 - axis)) for axis in (0, 1))
    if len(rows) == 0:
        return []
    inside = where[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    top, left = top + int(rows[0]), left + int(columns[0])
    whole = Box(
        (slice(top, top + inside.shape[0]), slice(left, left + inside.shape[1])),
        (_wider(top, inside.shape[0], shape[0]), _wider(left, inside.shape[1], shape[1])),
    )
    if whole.area <= SMALLEST_PX**2:
        return [whole]
    middle = [side // 2 for side in inside.shape]
    if inside.shape[0] > inside.shape[1]:
        parts = (inside[: middle[0]], top, left), (inside[middle[0] :], top + middle[0], left)
    else:
        parts = (inside[:, : middle[1]], top, left), (inside[:, middle[1] :], top, left + middle[1])
    apart = [box for part in parts for box in _boxes(*part, shape)]
    return apart if sum(box.area for box in apart) < WORTH_SHARE * whole.area else [whole]


def _wider(first: int, length: int, size: int) -> slice:
    start = max(0, first - CONTEXT_PX)
    start -= start % MULTIPLE_PX
    stop = first + length + CONTEXT_PX
    return slice(start, min(size, stop + -(stop - start) % MULTIPLE_PX))
