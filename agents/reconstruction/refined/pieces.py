"""The unbranched pieces of a centreline, and chains of them: a thread's course through one image."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import Centrelines

MOST_SEEN_PIECES = 150
"""The longest ones; all others are clutter."""
SHORTEST_PIECE_WIDTHS = 2.0
"""What is shorter has no direction."""


@dataclass(frozen=True)
class Chain:
    """A thread's course through one image, from one end to the other.

    Fields:
        point_px: in order.
        along_px: length until each point, gaps included.
        piece: which piece of the centrelines each point is from.
        index: of each point among the centrelines' points.
    """

    point_px: Float64[np.ndarray, "n 2"]
    along_px: Float64[np.ndarray, "n"]
    width_px: Float64[np.ndarray, "n"]
    deviation_px: Float64[np.ndarray, "n"]
    piece: Int64[np.ndarray, "n"]
    index: Int64[np.ndarray, "n"]


def pieces_of(lines: Centrelines) -> list[Int64[np.ndarray, "k"]]:
    """The indices of each piece that is long enough to have a direction."""
    if not len(lines.piece):
        return []
    width = float(np.median(lines.width_px))
    every = np.split(np.arange(len(lines.piece)), np.flatnonzero(np.diff(lines.piece)) + 1)
    length = [length_px(lines.point_px[p]) if len(p) >= 3 else 0.0 for p in every]
    longest = np.argsort(length)[::-1][:MOST_SEEN_PIECES]
    return [every[k] for k in sorted(longest) if length[k] >= SHORTEST_PIECE_WIDTHS * width and length[k] > 0]


def chain_of(lines: Centrelines, parts: list[Int64[np.ndarray, "k"]]) -> Chain:
    """The chain of pieces, each given by the indices of its points in their order along the chain."""
    index = np.concatenate(parts)
    points = lines.point_px[index]
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    return Chain(points, along, lines.width_px[index], lines.deviation_px[index], lines.piece[index], index)


def length_px(points: Float64[np.ndarray, "n 2"]) -> float:
    """Of a polyline."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def direction_outward(points: Float64[np.ndarray, "n 2"], reach: float) -> Float64[np.ndarray, "2"]:
    """The unit vector that leads outward at the first of these points, by those within reach of it."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    near = points[along <= max(reach, along[min(2, len(along) - 1)])]
    t = np.linspace(-0.5, 0.5, len(near))
    slope = -(t[:, None] * (near - near.mean(axis=0))).sum(axis=0)
    return slope / max(float(np.linalg.norm(slope)), 1e-9)
