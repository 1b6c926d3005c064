"""What travels of a line, and centrelines without what is not meant."""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from schemas.messages import Centrelines

SPACING_PX = 6
"""Of the points that travel; those of centrelines lie a pixel apart."""

Piece = Int64[np.ndarray, "k"]
"""The indices of a piece's points among the centrelines'."""


def thinned(points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "k 2"]:
    """Fewer of them, both ends included."""
    return points[np.unique(np.append(np.arange(0, len(points), SPACING_PX), len(points) - 1))]


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
    shift = np.zeros(2)
    if shifted:
        shift[0] = np.median(line_px[:, 0]) - np.median(np.concatenate(points)[:, 0])
    tree = cKDTree(line_px)
    places = [np.asarray(tree.query(piece + shift)[1]) for piece in points]
    turned = [piece if at[-1] >= at[0] else piece[::-1] for piece, at in zip(points, places, strict=True)]
    return np.concatenate([turned[k] for k in np.argsort([np.median(at) for at in places], kind="stable")])


def without(lines: Centrelines, pieces: list[Piece]) -> Centrelines:
    """The centrelines without these pieces."""
    if not pieces:
        return lines
    kept = np.ones(len(lines.piece), bool)
    kept[np.concatenate(pieces)] = False
    number = np.cumsum(np.diff(lines.piece[kept], prepend=-1) > 0) - 1
    return Centrelines(lines.point_px[kept], number, lines.width_px[kept], lines.deviation_px[kept])
