"""Paths through pieces of a curve: the likeliest one, and all of them together (Held and Karp 1962).

A path visits some of the pieces, each once. A piece has two ends, 2p and 2p + 1; who enters by one leaves by the other.
A path scores what its pieces, the joins between them and its own two ends score together, and its probability goes as
the exponential of that. Both programmes go over all subsets of the pieces, so that both are exact: time and memory grow
as 2 to the power of their number.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import Centrelines

Path = list[tuple[int, bool]]
"""Pieces in order, each with whether it is passed from its first end to its last."""


@dataclass(frozen=True)
class Scores:
    """Logarithms of likelihood ratios, of one set of pieces or, along further axes before, of several of one size.

    Fields:
        join: of a path that goes on from end to end rather than not; minus infinity where none does.
        piece: of a piece on the path rather than outside.
        end: of a path that ends there.
    """

    join: Float64[np.ndarray, "*n e e"]
    piece: Float64[np.ndarray, "*n p"]
    end: Float64[np.ndarray, "*n e"]

    def without_join(self, one: int, other: int) -> "Scores":
        """The same where no path joins two ends; the path's own end, where both are the same."""
        if one == other:
            end = self.end.copy()
            end[one] = -np.inf
            return replace(self, end=end)
        join = self.join.copy()
        join[one, other] = join[other, one] = -np.inf
        return replace(self, join=join)


def likeliest_path(scores: Scores, through: int | None = None) -> Path:
    """The path of the greatest score, through a piece where one is named; empty where there is none."""
    value = _table(scores, np.maximum)
    total = _ended(value, scores, through)
    mask, end = (int(k) for k in np.unravel_index(total.argmax(), total.shape))
    if not np.isfinite(total[mask, end]):
        return []
    path: Path = []
    while True:
        path.append((end // 2, end % 2 == 1))
        mask &= ~(1 << (end // 2))
        if not mask:
            return path[::-1]
        end = int((value[mask] + scores.join[:, end ^ 1]).argmax())


def log_total(scores: Scores, through: int | Int64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
    """The logarithm of the sum of the exponentials of the scores of all paths through a piece, each counted twice."""
    return np.logaddexp.reduce(_ended(_table(scores, np.logaddexp), scores, through), axis=(-2, -1))


def ends_of(path: Path) -> list[tuple[int, int]]:
    """The ends that a path joins, pair by pair; its own first and last end with themselves."""
    inner = [end for piece, forward in path for end in (2 * piece + (not forward), 2 * piece + forward)]
    every = [inner[0], *inner, inner[-1]]
    return list(zip(every[::2], every[1::2], strict=True))


def score(path: Path, scores: Scores) -> float:
    """That of a path."""
    (first, _), *joins, (last, _) = ends_of(path)
    inner = sum(float(scores.join[join]) for join in joins) + sum(float(scores.piece[piece]) for piece, _ in path)
    return inner + float(scores.end[first] + scores.end[last])


def _ended(
    value: Float64[np.ndarray, "*n s e"], scores: Scores, through: int | Int64[np.ndarray, "*n"] | None
) -> Float64[np.ndarray, "*n s e"]:
    """The table with the paths' last ends, of paths through a piece alone where one is named."""
    total = value + scores.end[..., None, :]
    if through is None:
        return total
    visited = (np.arange(value.shape[-2]) >> np.asarray(through)[..., None]) & 1 > 0
    return np.where(visited[..., None], total, -np.inf)


def _table(scores: Scores, add: np.ufunc) -> Float64[np.ndarray, "*n s e"]:
    """For each subset of the pieces, of all paths through just these that leave by an end: the scores, added up."""
    count = scores.piece.shape[-1]
    masks, ends = np.arange(1 << count), np.arange(2 * count)
    value = np.full((*scores.piece.shape[:-1], len(masks), len(ends)), -np.inf)
    value[..., 1 << (ends // 2), ends] = scores.piece[..., ends // 2] + scores.end[..., ends ^ 1]
    size = np.bitwise_count(masks)
    for smaller in range(1, count):
        of_size = masks[size == smaller]
        for end in ends:
            before = of_size[(of_size >> (end // 2)) & 1 == 0]
            reached = add.reduce(value[..., before, :] + scores.join[..., None, :, end ^ 1], axis=-1)
            value[..., before | (1 << (end // 2)), end] = reached + scores.piece[..., end // 2, None]
    return value


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
