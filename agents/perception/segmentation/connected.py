"""Masks and connected pieces told by the pixels that they hold: whole images take several times as long."""

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64


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
