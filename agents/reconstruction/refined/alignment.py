"""Which place of the right centreline each place of the left one corresponds to (epipolar dynamic programming).

Candidates of a left sample are all crossings of its row by right pieces. A way through candidates of successive
samples is sought that keeps most samples and changes disparity least, for the size of the steps between them and for
how well each disparity is known: where a piece runs along the rows, its crossing with a row says little. Right pieces
need no order of their own; the way gives it.
"""

import itertools
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.reconstruction.refined.paths import Chain
from schemas.messages import Centrelines
from shared.disparities import Disparities

SPACING_PX = 5.0
FEWEST_SAMPLES, MOST_SAMPLES, MOST_CANDIDATES = 8, 1000, 3000
"""Time and memory grow with the square of the candidates; only thread that winds over the whole image has more."""
ROW_DEVIATION_PX = 0.25
LEAST_SLOPE, STEEP = 0.08, 0.2
"""dv/dl below which a crossing with a row says nothing, and from which there must be one."""
GRADIENT = 0.25
"""Change of disparity per pixel along the thread that is common."""
DEAREST_STEP = 12.0
END_ROWS_PX = 1.5
"""Rows of the two images of one end lie no farther apart than this, or than the thread is wide there."""
END_DEVIATION_PX = 1.0
BACKWARD_PX = 3.0
DETOUR_PX, DETOUR_SHARE = 6.0, 0.5
SLOPE_REACH = 4
WORTHLESS_PX2 = 10.0
"""Variance of disparity at which a match is worth half as much as a certain one."""
SKIP = 0.35
OTHER_PIECE, CUT_PX = 1.0, 30.0
"""What another right piece costs, but over a gap of the left image that is longer than this: what hides thread from the
one eye hides it from the other as well."""
OTHER_STRAND = 4.0


@dataclass(frozen=True)
class Alignment:
    """Matched samples in order along the left chain.

    Fields:
        along_px: of each on the left chain.
        disparity_px, variance_px2: of disparity, by the slopes of both curves.
        right_index: fractional index of the place among the points of the right centrelines.
        share: of the samples that cross the rows, those that are matched.
        score: the best way's.
    """

    along_px: Float64[np.ndarray, "k"]
    disparity_px: Float64[np.ndarray, "k"]
    variance_px2: Float64[np.ndarray, "k"]
    right_index: Float64[np.ndarray, "k"]
    share: float
    score: float


@dataclass(frozen=True)
class Candidates:
    """Right places that left samples may correspond to, in the order of the samples.

    Fields:
        sample: number of the left sample.
        index: fractional index among the right points, of the piece `piece`, `along_px` from the first point of all.
        forward: 1 where both curves pass the row in one direction, -1 where in opposite ones, 0 where unknown.
    """

    sample: Int64[np.ndarray, "k"]
    disparity_px: Float64[np.ndarray, "k"]
    variance_px2: Float64[np.ndarray, "k"]
    index: Float64[np.ndarray, "k"]
    piece: Int64[np.ndarray, "k"]
    along_px: Float64[np.ndarray, "k"]
    forward: Float64[np.ndarray, "k"]

    def __getitem__(self, chosen: Int64[np.ndarray, "n"] | Bool[np.ndarray, "k"]) -> "Candidates":
        return Candidates(*(getattr(self, each.name)[chosen] for each in fields(self)))


def align(left: Chain, right: Centrelines, reach: Disparities) -> Alignment | None:
    """The best correspondence of a left chain with the right pieces; None where nothing corresponds."""
    count = int(np.clip(left.along_px[-1] / SPACING_PX, FEWEST_SAMPLES, MOST_SAMPLES))
    at = _samples(left, count)
    candidates = _candidates(left, at, right, reach)
    if len(candidates.sample) > MOST_CANDIDATES:
        at = _samples(left, max(FEWEST_SAMPLES, count * MOST_CANDIDATES // len(candidates.sample)))
        candidates = _candidates(left, at, right, reach)
        candidates = candidates[np.sort(np.argsort(candidates.variance_px2, kind="stable")[:MOST_CANDIDATES])]
    if len(candidates.sample) < 2:
        return None
    chosen, score = _best_way(candidates, left.point_px[at], left.along_px[at], runs(left)[at])
    if len(chosen) < 2:
        return None
    way = candidates[chosen]
    steep = np.abs(slopes(left.point_px, runs(left)))[at] >= STEEP
    steep[way.sample] = True
    return Alignment(
        left.along_px[at][way.sample],
        way.disparity_px,
        way.variance_px2,
        way.index,
        len(chosen) / int(steep.sum()),
        score,
    )


def reversed_along(aligned: Alignment, length_px: float) -> Alignment:
    """The same along the chain from its other end."""
    return replace(
        aligned,
        along_px=length_px - aligned.along_px[::-1],
        disparity_px=aligned.disparity_px[::-1],
        variance_px2=aligned.variance_px2[::-1],
        right_index=aligned.right_index[::-1],
    )


def _samples(left: Chain, count: int) -> Int64[np.ndarray, "s"]:
    """Indices of points that lie about evenly along the chain."""
    wanted = np.linspace(0.0, left.along_px[-1], count)
    return np.unique(np.clip(np.searchsorted(left.along_px, wanted), 0, len(left.along_px) - 1))


def piece_ends(lines: Centrelines) -> Int64[np.ndarray, "e"]:
    """The indices of the first and last point of every piece."""
    bounds = np.flatnonzero(np.diff(lines.piece, prepend=-1, append=-1))
    return np.unique(np.concatenate((bounds[:-1], bounds[1:] - 1)))


def slopes(points: Float64[np.ndarray, "n 2"], run: Int64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """dv/dl over some pixels, within runs of points of the same never decreasing number."""
    index = np.arange(len(points))
    low = np.maximum(index - SLOPE_REACH, np.searchsorted(run, run, side="left"))
    high = np.minimum(index + SLOPE_REACH, np.searchsorted(run, run, side="right") - 1)
    chord = points[high] - points[low]
    return chord[:, 1] / np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-9)


def _candidates(left: Chain, at: Int64[np.ndarray, "s"], right: Centrelines, reach: Disparities) -> Candidates:
    crossings, ends = _row_crossings(left, at, right), _common_ends(left, len(at), right)
    both = Candidates(
        *(np.concatenate((getattr(crossings, f.name), getattr(ends, f.name))) for f in fields(Candidates))
    )
    both = both[np.argsort(both.sample, kind="stable")]
    return both[(both.disparity_px >= reach.least_px) & (both.disparity_px <= reach.most_px)]


def _row_crossings(left: Chain, at: Int64[np.ndarray, "s"], right: Centrelines) -> Candidates:
    """Where right pieces cross the rows of left samples, at angles that tell where."""
    v = left.point_px[at, 1]
    below = right.point_px[None, :, 1] <= v[:, None]
    crossing = (below[:, 1:] != below[:, :-1]) & (right.piece[1:] == right.piece[:-1])
    sample, k = np.nonzero(crossing)
    (u0, v0), (u1, v1) = right.point_px[k].T, right.point_px[k + 1].T
    share = (v[sample] - v0) / (v1 - v0)
    slope_left = slopes(left.point_px, runs(left))[at[sample]]
    slope_right = slopes(right.point_px, right.piece)[k]
    slope = np.minimum(np.abs(slope_left), np.abs(slope_right))
    found = Candidates(
        sample=sample,
        disparity_px=left.point_px[at[sample], 0] - (u0 + share * (u1 - u0)),
        variance_px2=2.0 * (ROW_DEVIATION_PX / np.maximum(slope, LEAST_SLOPE)) ** 2,
        index=k + share,
        piece=right.piece[k],
        along_px=_along(right)[k],
        forward=np.sign(slope_left * slope_right),
    )
    return found[slope >= LEAST_SLOPE]


def _common_ends(left: Chain, samples: int, right: Centrelines) -> Candidates:
    """Where the thread ends in one image it ends in the other, however it runs there: ends of about the same row."""
    ends = piece_ends(right)
    sample = np.repeat([0, samples - 1], len(ends))
    point = left.point_px[[0, -1]][(sample > 0).astype(int)]
    index = np.tile(ends, 2)
    apart = np.abs(right.point_px[index, 1] - point[:, 1])
    found = Candidates(
        sample=sample,
        disparity_px=point[:, 0] - right.point_px[index, 0],
        # what is apart in rows is so along the thread
        variance_px2=END_DEVIATION_PX**2 + apart**2,
        index=index.astype(np.float64),
        piece=right.piece[index],
        along_px=_along(right)[index],
        forward=np.zeros(len(index)),
    )
    return found[apart <= np.maximum(END_ROWS_PX, right.width_px[index])]


def runs(left: Chain) -> Int64[np.ndarray, "n"]:
    """Numbers of the chain's stretches without a gap, from 0."""
    return np.concatenate(([0], np.cumsum(np.diff(left.piece) != 0)))


def _along(lines: Centrelines) -> Float64[np.ndarray, "n"]:
    steps = np.linalg.norm(np.diff(lines.point_px, axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(steps)))


def _best_way(
    c: Candidates, points: Float64[np.ndarray, "s 2"], along: Float64[np.ndarray, "s"], run: Int64[np.ndarray, "s"]
) -> tuple[Int64[np.ndarray, "k"], float]:
    """Indices of the candidates on the way with the best score."""
    best = 1.0 / (1.0 + c.variance_px2 / WORTHLESS_PX2)
    cost = _step_costs(c, best, points, along, run)
    before = np.full(len(best), -1)
    starts = np.searchsorted(c.sample, np.arange(c.sample[-1] + 2))
    for first, last in itertools.pairwise(starts):
        if first in (last, 0):
            continue
        total = best[:first, None] - cost[:first, first:last]
        previous = total.argmax(axis=0)
        gain = total[previous, np.arange(last - first)]
        best[first:last] += np.maximum(gain, 0.0)
        before[first:last] = np.where(gain > 0, previous, -1)
    way = [int(best.argmax())]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    return np.array(way[::-1]), float(best.max())


def _step_costs(
    c: Candidates,
    worth: Float64[np.ndarray, "k"],
    points: Float64[np.ndarray, "s 2"],
    along: Float64[np.ndarray, "s"],
    run: Int64[np.ndarray, "s"],
) -> Float64[np.ndarray, "k k"]:
    """The cost of going on from each candidate (row) to each of a later sample (column)."""

    def change_of(values: np.ndarray) -> np.ndarray:
        return values[None] - values[:, None]

    step, change = change_of(along[c.sample]), change_of(c.disparity_px)
    variance = c.variance_px2[None] + c.variance_px2[:, None] + (GRADIENT * step) ** 2
    cost = np.minimum(change**2 / np.maximum(variance, 1e-9), DEAREST_STEP)
    # samples that are passed over, for what their candidates are worth; a stretch without any costs nothing
    rank = np.unique(c.sample, return_inverse=True)[1]
    most = np.zeros(rank[-1] + 1)
    np.maximum.at(most, rank, worth)
    until = np.cumsum(most)
    cost += SKIP * np.maximum((until - most)[rank][None] - until[rank][:, None], 0.0)
    # on one piece the way keeps its direction, for rows rise in both images together, and takes no detour
    ahead = change_of(c.along_px)
    back = (ahead * c.forward[None] < -BACKWARD_PX) | (ahead * c.forward[:, None] < -BACKWARD_PX)
    u, v = points[c.sample].T
    direct = np.hypot(change_of(u) - change, change_of(v))
    detour = np.abs(ahead) - direct > DETOUR_PX + DETOUR_SHARE * np.abs(step)
    cut = (change_of(run[c.sample]) != 0) & (step > CUT_PX)
    cost += np.where(change_of(c.piece) == 0, OTHER_STRAND * (back | detour), np.where(cut, 0.0, OTHER_PIECE))
    return cost
