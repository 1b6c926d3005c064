"""What travels of a line, and centrelines without what is not meant."""

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import cKDTree

from schemas.messages import Centrelines

SPACING_PX = 6
"""Of the points that travel; those of centrelines lie a pixel apart."""

Piece = Int64[np.ndarray, "k"]
"""The indices of a piece's points among the centrelines'."""


def thinned(points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "k 2"]:
    """Fewer of them, both ends included."""
    some = points[::SPACING_PX]
    return some if (len(points) - 1) % SPACING_PX == 0 else np.concatenate((some, points[-1:]))


def along(
    line_px: Float64[np.ndarray, "n 2"], lines: Centrelines, pieces: list[Piece], shifted: bool
) -> Float64[np.ndarray, "m 2"]:
    """Thinned pieces in order along a line.

    Args:
        line_px: at least one point.
        shifted: whether the pieces are of the other image, in the same rows.
    """
    if not pieces:
        return np.zeros((0, 2))
    points = [thinned(lines.point_px[piece]) for piece in pieces]
    every = np.concatenate(points)
    shift = np.median(line_px[:, 0]) - np.median(every[:, 0]) if shifted else 0.0
    last = np.cumsum(np.array([len(piece) for piece in points], np.intp))
    first = np.concatenate((np.zeros(1, np.intp), last[:-1]))
    told = every[np.concatenate((first, (first + last) // 2, last - 1))] + np.array((shift, 0.0))
    begins, middle, ends = np.asarray(cKDTree(line_px).query(told)[1], np.intp).reshape(3, -1)
    turned = [piece[::-1] if back else piece for piece, back in zip(points, ends < begins, strict=True)]
    # pieces of one line do not overlap, so that where each has its middle tells their order
    return np.concatenate([turned[k] for k in np.argsort(middle, kind="stable")])


def without(lines: Centrelines, pieces: list[Piece]) -> Centrelines:
    """The centrelines without these pieces."""
    if not pieces:
        return lines
    kept = np.ones(len(lines.piece), bool)
    kept[np.concatenate(pieces)] = False
    return _those(lines, kept)


def only(lines: Centrelines, pieces: list[Piece]) -> Centrelines:
    """These pieces of the centrelines alone."""
    kept = np.zeros(len(lines.piece), bool)
    kept[np.concatenate(pieces)] = True
    return _those(lines, kept)


def _those(lines: Centrelines, kept: Bool[np.ndarray, "n"]) -> Centrelines:
    number = np.cumsum(np.diff(lines.piece[kept], prepend=-1) > 0) - 1
    return Centrelines(lines.point_px[kept], number, lines.width_px[kept], lines.deviation_px[kept])
