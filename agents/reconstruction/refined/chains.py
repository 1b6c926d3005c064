"""Which pieces of a centreline follow each other: the thread's course through one image.

A piece ends where the thread crosses itself, disappears, or ends. Two ends belong together where a thread that is no
more bent than elsewhere leads from one to the other: for the angles a and b, in the same sense of rotation, between
the way across and the directions of both ends, the least bent way has ∫κ² = 4 (a² − a b + b²) / g for a gap g
(Hermite's cubic; an arc has a = b), against κ₀² g for as much of the rest of the thread.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from agents.reconstruction.refined.ways import richest_way
from schemas.messages import Centrelines

TANGENT_WIDTHS = 3.0
"""Widths of thread over which the direction of an end is measured: crossings bend the last pixels."""
ANGLE_DEVIATION = 0.2
"""Of the direction of an end, in radians."""
LEAST_CURVATURE_PX = 1 / 400
GAP_SCALE_SHARE = 0.03
"""Of the image's width: a gap as long as this costs as much as one standard deviation of bending."""
DEAREST_LINK = 40.0
KINK = 12.0
DISPARITY_DEVIATION_PX, DISPARITY_GRADIENT = 1.0, 0.25
LEAST_LINK_SHARE = 0.25
"""Of what a link costs in one image: what both show together makes it no cheaper."""
COVERED = -1.0
"""An end is taken for covered where that is so much likelier (in logarithms) than that it is a tip."""
PRIZE_SHARE = 0.005
JUNCTION_WIDTHS = 5.0
SHARED_WIDTHS = 25.0
MOST_PIECES, MOST_THREADS = 11, 4
MOST_SEEN_PIECES = 150
"""The longest ones; all others are clutter. Time and memory grow with their square."""
SHORTEST_PIECE_WIDTHS = 2.0


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

    @property
    def seen_px(self) -> float:
        """How much of it is seen."""
        steps = np.diff(self.along_px)
        return float(steps[np.diff(self.piece) == 0].sum())


@dataclass(frozen=True)
class Ends:
    """What both images say of the ends of pieces, at the centrelines' points that are ends.

    Fields:
        tip: the logarithm of how much likelier the thread ends here than is covered; 0 where that is unknown.
        disparity_px: not a number where that is unknown.
    """

    tip: Float64[np.ndarray, "n"]
    disparity_px: Float64[np.ndarray, "n"]


def chains(lines: Centrelines, image_width: int, known: Ends | None = None) -> list[Chain]:
    """The threads of an image, the one that is seen longest first, by what both images say of the ends where known."""
    pieces = _pieces(lines)
    if not pieces:
        return []
    links = _links(lines, pieces, image_width, known)
    shared = _shared(lines, pieces)
    ends = np.concatenate((np.arange(2 * len(pieces)), *(np.array([2 * p, 2 * p + 1]) for p in shared)))
    links = links[np.ix_(ends, ends)]
    for copy, p in enumerate(shared, len(pieces)):
        links[2 * copy : 2 * copy + 2, 2 * p : 2 * p + 2] = links[2 * p : 2 * p + 2, 2 * copy : 2 * copy + 2] = np.inf
    pieces = pieces + [pieces[p] for p in shared]
    prize = np.array([_length(lines.point_px[p]) for p in pieces]) / (PRIZE_SHARE * image_width)
    found = [
        _chain(lines, [pieces[p][:: 1 if forward else -1] for p, forward in order]) for order in _orders(links, prize)
    ]
    return sorted(found, key=lambda chain: -chain.seen_px)


def _pieces(lines: Centrelines) -> list[Int64[np.ndarray, "k"]]:
    """The indices of each piece that is long enough to have a direction."""
    if not len(lines.piece):
        return []
    cuts = np.flatnonzero(np.diff(lines.piece)) + 1
    width = float(np.median(lines.width_px))
    every = np.split(np.arange(len(lines.piece)), cuts)
    length = [_length(lines.point_px[p]) if len(p) >= 3 else 0.0 for p in every]
    longest = np.argsort(length)[::-1][:MOST_SEEN_PIECES]
    return [every[k] for k in sorted(longest) if length[k] >= SHORTEST_PIECE_WIDTHS * width and length[k] > 0]


def _shared(lines: Centrelines, pieces: list[Int64[np.ndarray, "k"]]) -> list[int]:
    """Pieces that two strands may share: short, with other ends of at least two others at both of their own."""
    if not pieces:
        return []
    width = float(np.median(lines.width_px))
    ends = np.array([end for p in pieces for end in (lines.point_px[p[0]], lines.point_px[p[-1]])])
    near = np.linalg.norm(ends[None] - ends[:, None], axis=2) <= JUNCTION_WIDTHS * width
    owner = np.arange(len(ends)) // 2
    near &= owner[:, None] != owner[None]
    busy = near.sum(axis=1) >= 2
    short = np.array([_length(lines.point_px[p]) <= SHARED_WIDTHS * width for p in pieces])
    return [int(p) for p in np.flatnonzero(short & busy[::2] & busy[1::2])]


def _length(points: Float64[np.ndarray, "n 2"]) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _links(
    lines: Centrelines, pieces: list[Int64[np.ndarray, "k"]], image_width: int, known: Ends | None
) -> Float64[np.ndarray, "e e"]:
    """The cost of going from end to end; end 2p is the first, 2p + 1 the last of piece p."""
    ends = np.array([end for p in pieces for end in (lines.point_px[p[0]], lines.point_px[p[-1]])])
    width = float(np.median(lines.width_px))
    reach = TANGENT_WIDTHS * width
    outward = np.array([direction_outward(lines.point_px[way], reach) for p in pieces for way in (p, p[::-1])])
    across = ends[None] - ends[:, None]
    gap = np.linalg.norm(across, axis=2)
    here = np.broadcast_to(outward[:, None], across.shape)
    there = np.broadcast_to(-outward[None], across.shape)
    # over less than some widths the way across has no direction of its own, and the ends share the turn
    own = np.clip(gap / (2 * reach), 0.0, 1.0)[..., None]
    middle = here + there
    middle = middle / np.maximum(np.linalg.norm(middle, axis=2, keepdims=True), 1e-9)
    way = own * across / np.maximum(gap, 1e-9)[..., None] + (1 - own) * middle
    a, b = _angle(here, way), _angle(way, there)
    curvature = max(_curvature(lines, pieces), LEAST_CURVATURE_PX)
    variance = ANGLE_DEVIATION**2 + (0.5 * curvature * gap) ** 2
    # ends that touch may be two sides of a kink, as where a thread leaves its needle
    kink = KINK * np.maximum(1.0, gap / reach)
    cost = np.minimum((a * a - a * b + b * b) / variance, kink) + (gap / (GAP_SCALE_SHARE * image_width))
    # beside each other rather than after each other
    backwards = ((across * here).sum(axis=2) < 0) | ((across * there).sum(axis=2) < 0)
    sideways = (gap > reach) & backwards
    if known is not None:
        index = np.array([end for p in pieces for end in (p[0], p[-1])])
        tip, disparity = known.tip[index], known.disparity_px[index]
        # an end beside another piece's is cut, not covered, and rows that are off make either look covered
        other = np.arange(len(ends))[:, None] // 2 != np.arange(len(ends))[None] // 2
        tip = np.where(((gap < 2 * reach) & other).any(axis=1), np.maximum(tip, 0.0), tip)
        # at a crossing both images cut the thread at one place, as if it ended there
        cost = _in_both_images(cost, gap, np.clip(gap / (2 * reach), 0.0, 1.0) * _evidence(tip), disparity)
        # what is hidden may turn back
        sideways &= ~((tip[:, None] < COVERED) & (tip[None] < COVERED))
    cost[sideways] = np.inf
    same = np.arange(len(ends)) // 2
    cost[same[:, None] == same[None]] = np.inf
    return np.where(cost <= DEAREST_LINK, cost, np.inf)


def _evidence(tip: Float64[np.ndarray, "e"]) -> Float64[np.ndarray, "e e"]:
    """What speaks against a link from end to end: what is covered at one side of a gap is so at the other, too."""
    less, more = np.minimum(tip[:, None], tip[None]), np.maximum(tip[:, None], tip[None])
    return np.where(more > 0, more + np.maximum(less, 0.0), less + more)


def _in_both_images(
    cost: Float64[np.ndarray, "e e"],
    gap: Float64[np.ndarray, "e e"],
    evidence: Float64[np.ndarray, "e e"],
    disparity: Float64[np.ndarray, "e"],
) -> Float64[np.ndarray, "e e"]:
    """The cost of links by one image, with what both together say; disparities that are unknown cost nothing."""
    change = np.nan_to_num(disparity[None] - disparity[:, None])
    steep = np.minimum(change**2 / (DISPARITY_DEVIATION_PX**2 + (DISPARITY_GRADIENT * gap) ** 2), KINK)
    return np.maximum(cost + evidence, LEAST_LINK_SHARE * cost) + steep


def direction_outward(points: Float64[np.ndarray, "n 2"], reach: float) -> Float64[np.ndarray, "2"]:
    """Outward at the first of these points."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    near = points[along <= max(reach, along[min(2, len(along) - 1)])]
    t = np.linspace(-0.5, 0.5, len(near))
    slope = -(t[:, None] * (near - near.mean(axis=0))).sum(axis=0)
    return slope / max(float(np.linalg.norm(slope)), 1e-9)


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1))


def _curvature(lines: Centrelines, pieces: list[Int64[np.ndarray, "k"]]) -> float:
    """Root of the mean square of the curvature over some widths, per pixel."""
    step = max(2, round(2 * float(np.median(lines.width_px))))
    turns: list[np.ndarray] = []
    for p in pieces:
        points = lines.point_px[p[::step]]
        if len(points) > 2:
            chord = np.diff(points, axis=0)
            turns.append(_angle(chord[:-1], chord[1:]) / step)
    return float(np.sqrt(np.mean(np.concatenate(turns) ** 2))) if turns else 0.0


def _orders(cost: Float64[np.ndarray, "e e"], prize: Float64[np.ndarray, "p"]) -> list[list[tuple[int, bool]]]:
    """Threads as ways through pieces, the richest first; a piece is on one way at most."""
    left, found = set(range(len(prize))), []
    while left and len(found) < MOST_THREADS:
        pieces = sorted(sorted(left, key=lambda p: -prize[p])[:MOST_PIECES])
        ends = np.repeat(2 * np.array(pieces), 2) + np.tile([0, 1], len(pieces))
        way = richest_way(cost[np.ix_(ends, ends)], prize[pieces])
        found.append([(pieces[p], forward) for p, forward in way])
        left -= {p for p, _ in found[-1]}
    return found


def _chain(lines: Centrelines, parts: list[Int64[np.ndarray, "k"]]) -> Chain:
    index = np.concatenate(parts)
    points = lines.point_px[index]
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    return Chain(points, along, lines.width_px[index], lines.deviation_px[index], lines.piece[index], index)
