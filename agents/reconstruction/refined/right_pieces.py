"""Which points of the right centreline show the thread, and where on it, from the matches of some of them.

Between the matches of a piece its points are interpolated. Past them it may show other thread, or what hides it in the
left image; but thread along the rows has no matches, since its crossings with them say nothing. There both images show
it going on in the same rows.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.reconstruction.refined.alignment import STEEP, Alignment, piece_ends, runs, slopes
from agents.reconstruction.refined.pieces import Chain
from schemas.messages import Centrelines

BEYOND_PX = 10
"""How far past its last matched point a right piece is taken to show the thread still, whatever the left one shows."""
LEVEL_PX = 4.0
"""Rows of both images that are no farther apart than this may show the same place along the rows."""


def of_right(
    piece: int, left: Chain, right: Centrelines, aligned: Alignment, stride: int
) -> tuple[Int64[np.ndarray, "k"], Float64[np.ndarray, "k"], Bool[np.ndarray, "k"]]:
    """Indices of a piece's points, their parameters as shares of the left chain, and which are the thread's ends."""
    matched = right.piece[aligned.right_index.astype(int)] == piece
    t, s = aligned.right_index[matched], aligned.along_px[matched] / left.along_px[-1]
    # a piece that two strands share is matched twice, and its points then belong to the longer match
    order = np.argsort(t, kind="stable")
    t, s = t[order], s[order]
    mine = np.flatnonzero(right.piece == piece)
    index = mine[::stride]
    place, pace = np.interp(index, t, s), _pace(t, s, mine, left)
    kept = (index >= t[0] - BEYOND_PX) & (index <= t[-1] + BEYOND_PX)
    for outside, last in ((np.flatnonzero(index < t[0])[::-1], 0), (np.flatnonzero(index > t[-1]), -1)):
        place[outside] = s[last] + pace * (index[outside] - t[last])
        kept[outside] |= _goes_on(left, right.point_px[index[outside], 1], place[outside], s[last])
    index, place = index[kept], place[kept]
    is_end = np.zeros(len(index), bool)
    ends = piece_ends(right)
    for which, value in ((0, 0.0), (-1, 1.0)):
        at = aligned.right_index[which]
        if matched[which] and aligned.along_px[which] == left.along_px[which] and at in ends:
            index, place = np.append(index, int(at)), np.append(place, value)
            is_end = np.append(is_end, True)
    inside = (place >= -0.005) & (place <= 1.005)
    return index[inside], np.clip(place[inside], 0.0, 1.0), is_end[inside]


def _pace(t: Float64[np.ndarray, "m"], s: Float64[np.ndarray, "m"], mine: Int64[np.ndarray, "k"], left: Chain) -> float:
    """By how much the parameter changes from point to point."""
    if t[-1] > t[0]:
        return float((s[-1] - s[0]) / (t[-1] - t[0]))
    if s[0] not in (0.0, 1.0) or t[0] not in (mine[0], mine[-1]):
        return 0.0
    # where only the thread's end is matched, the piece leads inward from it
    forward = (t[0] == mine[0]) == (s[0] == 0.0)
    return (1.0 if forward else -1.0) / float(left.along_px[-1])


def _goes_on(
    left: Chain, row: Float64[np.ndarray, "j"], place: Float64[np.ndarray, "j"], from_place: float
) -> Bool[np.ndarray, "j"]:
    """Going outward from a match, for how long the left image shows flat thread in the same rows without a gap."""
    length, run = float(left.along_px[-1]), runs(left)
    along = place * length
    level = np.abs(np.interp(along, left.along_px, left.point_px[:, 1]) - row) <= LEVEL_PX
    at = np.searchsorted(left.along_px, np.append(along, from_place * length)).clip(0, len(run) - 1)
    flat = np.abs(slopes(left.point_px, run))[at[:-1]] < STEEP
    return np.logical_and.accumulate(level & flat & (run[at[:-1]] == run[at[-1]]) & (place >= 0) & (place <= 1))
