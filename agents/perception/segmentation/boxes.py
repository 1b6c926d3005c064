"""Boxes that hold everything that is to be looked at, and little else: few where it is compact, more where it winds.

What is to be looked at is divided, in cells of some pixels, where two boxes have least to look at; each part likewise,
as long as that is less than before.

Masks and connected pieces are told by the pixels that they hold, for whole images take several times as long.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, UInt8

CONTEXT_PX = 32
"""Around a box that is looked at too. What is looked for lies far from the border of where it is looked for already."""
MULTIPLE_PX = 32
"""Of which the outer sides are, and where they begin, wherever the image allows it: the network halves five times."""
CELL_PX = 8
"""Boxes begin and end between cells of so many pixels."""
COST_PX = 2000.0
"""As much as looking at so many pixels is what a box costs by itself."""


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
    return [_box(rows, columns, where.shape) for rows, columns in _parts(_cells(where), 0, 0)]


def _cells(where: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "r c"]:
    """Which cells hold a pixel that is set."""
    below, beside = (-side % CELL_PX for side in where.shape)
    padded = cv2.copyMakeBorder(where.view(np.uint8), 0, below, 0, beside, cv2.BORDER_CONSTANT, value=0)
    of_rows = padded.reshape(-1, CELL_PX, padded.shape[1]).max(axis=1)
    return of_rows.reshape(len(of_rows), -1, CELL_PX).max(axis=2).view(bool)


def _parts(cells: Bool[np.ndarray, "r c"], top: int, left: int) -> list[tuple[slice, slice]]:
    """Rows and columns of cells, without empty ones at their sides, divided as long as that leaves less to look at."""
    rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    if len(rows) == 0:
        return []
    cells = cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    top, left = top + int(rows[0]), left + int(columns[0])
    by_row, by_column = _costs_divided(cells), _costs_divided(cells.T)
    best = min(by_row.min(initial=np.inf), by_column.min(initial=np.inf))
    if best >= _cost(*(np.array(side) for side in cells.shape)):
        return [(slice(top, top + cells.shape[0]), slice(left, left + cells.shape[1]))]
    if by_row.min(initial=np.inf) == best:
        cut = int(by_row.argmin()) + 1
        return _parts(cells[:cut], top, left) + _parts(cells[cut:], top + cut, left)
    cut = int(by_column.argmin()) + 1
    return _parts(cells[:, :cut], top, left) + _parts(cells[:, cut:], top, left + cut)


def _costs_divided(cells: Bool[np.ndarray, "r c"]) -> Float64[np.ndarray, "r-1"]:
    """What two boxes cost that are divided after each row but the last; the first and the last row hold something."""
    count, width = cells.shape
    row = np.arange(count)
    filled = cells.any(axis=1)
    first = np.where(filled, cells.argmax(axis=1), width)
    last = np.where(filled, width - 1 - cells[:, ::-1].argmax(axis=1), -1)
    # of the rows so far, and of those that are left
    above = np.maximum.accumulate(last) - np.minimum.accumulate(first) + 1
    below = (np.maximum.accumulate(last[::-1]) - np.minimum.accumulate(first[::-1]) + 1)[::-1]
    end_above = np.maximum.accumulate(np.where(filled, row, -1)) + 1
    start_below = np.minimum.accumulate(np.where(filled, row, count)[::-1])[::-1]
    return _cost(end_above, above)[:-1] + _cost(count - start_below, below)[1:]


def _cost(rows: Int64[np.ndarray, "*n"], columns: Int64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
    """What a box of so many cells costs, in pixels; as much is added around it as rounding does on average."""
    around = 2 * CONTEXT_PX + MULTIPLE_PX / 2
    return (CELL_PX * rows + around) * (CELL_PX * columns + around) + COST_PX


def _box(rows: slice, columns: slice, shape: tuple[int, ...]) -> Box:
    inner = [
        slice(CELL_PX * side.start, min(size, CELL_PX * side.stop))
        for side, size in zip((rows, columns), shape, strict=True)
    ]
    outer = [_wider(side, size) for side, size in zip(inner, shape, strict=True)]
    return Box((inner[0], inner[1]), (outer[0], outer[1]))


def _wider(inner: slice, size: int) -> slice:
    start = max(0, inner.start - CONTEXT_PX)
    start -= start % MULTIPLE_PX
    stop = inner.stop + CONTEXT_PX
    return slice(start, min(size, stop + -(stop - start) % MULTIPLE_PX))


def of_pixels(index: Int64[np.ndarray, "p"], shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """A mask of some pixels, by their indices."""
    mask = np.zeros(shape, bool)
    mask.ravel()[index] = True
    return mask


def extents(
    piece: Int32[np.ndarray, "p"], pixel: Int64[np.ndarray, "p"], columns: int, count: int
) -> Float64[np.ndarray, "c"]:
    """The diagonal of each of so many pieces, in pixels; 0 where a piece has none.

    Args:
        piece: of each pixel; pixel: their indices in an image of so many columns.
    """
    return np.hypot(*(_sides(piece, at, count) for at in np.divmod(pixel, columns)))


def _sides(piece: Int32[np.ndarray, "p"], at: Int64[np.ndarray, "p"], count: int) -> Float64[np.ndarray, "c"]:
    """How many rows, or columns, each piece reaches over; 0 where a piece has no pixel."""
    first, last = np.full(count, np.iinfo(np.int64).max), np.full(count, -1)
    np.minimum.at(first, piece, at)
    np.maximum.at(last, piece, at)
    return np.where(last >= 0, last - np.minimum(first, last) + 1.0, 0.0)


@dataclass(frozen=True)
class Near:
    """Where a thread may be, and how it looks.

    Fields:
        where: pixels that may be thread, in the image that is to be segmented.
        is_bright: whether it is brighter than its surroundings; else it is darker.
    """

    where: Bool[np.ndarray, "h w"]
    is_bright: bool


@dataclass(frozen=True)
class Meant:
    """Which of several threads is meant: the connected piece that has most weight.

    Fields:
        weight: of each pixel of the image that is to be segmented, from 0.
        alone: whether only that piece is kept; else also what looks like it.
        other_eye: coverage by it in the left image, where only there it was said what is meant, and this is the right.
    """

    weight: Float32[np.ndarray, "h w"]
    alone: bool
    other_eye: UInt8[np.ndarray, "h w"] | None = None


def piece_meant(mask: Bool[np.ndarray, "h w"], weight: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The connected piece of a mask with most weight; nothing where none has any."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    total = np.bincount(np.asarray(labels)[mask], weights=weight[mask], minlength=count)
    return np.asarray(labels) == int(np.argmax(total)) if total.any() else np.zeros(mask.shape, bool)
