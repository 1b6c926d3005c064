"""Pieces of the right image between which a thread goes straight on over a short gap, as one piece.

A glint or a stain takes a few pixels out of a thread. Both sides of such a gap are one strand where each is the only
thing near the other and neither turns. That matters along the rows: thread there has no matches but its ends, and what
lies beyond a gap would have no say. In the left image the course finds its way over gaps itself (`chains`).
"""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from schemas.messages import Centrelines

LONGEST_WIDTHS = 4.0
"""Of a gap: what hides more than that may hide an end, or a turn."""
DIRECTION_WIDTHS = 3.0
"""Over which the direction of an end is measured."""
STRAIGHT_RAD = 0.3
"""Neither end turns by more than that from its own direction into the way across."""
BESIDE_WIDTHS = 1.5
"""From the gap's ends: nearer than that nothing else is seen, or it is a crossing."""
LEAST_PX = 1e-9


def joined(lines: Centrelines) -> Centrelines:
    """The same points, those of joined pieces in the order of one; the others keep theirs."""
    if not len(lines.piece):
        return lines
    first = np.flatnonzero(np.diff(lines.piece, prepend=-1))
    last = np.append(first[1:], len(lines.piece)) - 1
    if len(first) < 2:
        return lines
    partner = _partners(lines, first, last)
    if (partner < 0).all():
        return lines
    order = _order(partner)
    parts = [np.arange(first[p], last[p] + 1)[:: 1 if forward else -1] for way in order for p, forward in way]
    index = np.concatenate(parts)
    length = [sum(int(last[p] - first[p]) + 1 for p, _ in way) for way in order]
    piece = np.repeat(np.arange(len(order)), length)
    return Centrelines(lines.point_px[index], piece, lines.width_px[index], lines.deviation_px[index])


def _partners(
    lines: Centrelines, first: Int64[np.ndarray, "p"], last: Int64[np.ndarray, "p"]
) -> Int64[np.ndarray, "e"]:
    """For each end, 2p of the first and 2p + 1 of the last point of piece p, the end it goes on to; -1 for none."""
    ends = np.column_stack((first, last)).ravel()
    width = float(np.median(lines.width_px))
    point, outward = lines.point_px[ends], _outward(lines, first, last, DIRECTION_WIDTHS * width)
    none = np.full(len(ends), -1)
    pairs = cKDTree(point).query_pairs(LONGEST_WIDTHS * width, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // 2 != pairs[:, 1] // 2]
    if not len(pairs):
        return none
    a, b = pairs.T
    across = point[b] - point[a]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), LEAST_PX)
    least = np.cos(STRAIGHT_RAD)
    straight = ((outward[a] * across).sum(axis=1) >= least) & ((outward[b] * -across).sum(axis=1) >= least)
    everything = cKDTree(lines.point_px)
    partner = none
    for i, j in pairs[straight].tolist():
        near = [np.asarray(everything.query_ball_point(point[e], BESIDE_WIDTHS * width), np.int64) for e in (i, j)]
        # a third piece beside the gap is another strand, and so is a third end a rival
        others = np.setdiff1d(lines.piece[np.concatenate(near)], lines.piece[ends[[i, j]]])
        if len(others) or ((pairs == i) | (pairs == j)).any(axis=1).sum() > 1:
            continue
        partner[i], partner[j] = j, i
    return partner


def _outward(
    lines: Centrelines, first: Int64[np.ndarray, "p"], last: Int64[np.ndarray, "p"], reach_px: float
) -> Float64[np.ndarray, "e 2"]:
    """The direction in which each end leaves its piece, over so many points, which lie about a pixel apart."""
    back = np.minimum(max(1, round(reach_px)), last - first)
    outward = np.stack(
        (lines.point_px[first] - lines.point_px[first + back], lines.point_px[last] - lines.point_px[last - back]),
        axis=1,
    ).reshape(-1, 2)
    return outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), LEAST_PX)


def _order(partner: Int64[np.ndarray, "e"]) -> list[list[tuple[int, bool]]]:
    """The pieces in ways, each with whether it is passed forward; a ring is opened where its first piece begins."""
    left = set(range(len(partner) // 2))
    ways: list[list[tuple[int, bool]]] = []
    for start in range(len(partner) // 2):
        if start not in left:
            continue
        entry = _first_end(2 * start, partner)
        way: list[tuple[int, bool]] = []
        while entry >= 0 and entry // 2 in left:
            left.remove(entry // 2)
            way.append((entry // 2, entry % 2 == 0))
            entry = int(partner[entry ^ 1])
        ways.append(way)
    return ways


def _first_end(entry: int, partner: Int64[np.ndarray, "e"]) -> int:
    """The end at which the way begins that enters a piece at that end."""
    at = entry
    while partner[at] >= 0:
        at = int(partner[at]) ^ 1
        if at == entry:
            break
    return at
