"""Which points of both eyes' centrelines show the same places of a thread: by rows, and by the disparity beside those.

Of a rectified pair, a place lies in the same row of both images. A row may cross a thread several times, and one eye
may miss a strand that the other sees. So a place is known for certain where a left point has one right one in its row
at a disparity that can be, and that one has no other left one; and next to such places, where one right point alone has
about the disparity that theirs go on to. On the same left line the others follow from these (`carried_on`): where it
runs along the rows, or where its rows hold several strands. Of a line without any nothing is said.

**Where no row tells**, along the rows and among other strands, the disparity beside does. Along a thread the disparity
changes slowly. So from places that are the same for certain it goes on, and says about where the right eye sees a place
that its row does not tell. That is the place of the right line nearest to it, of all that lie about there: where the
line crosses the rows, its row counts for most, and where it runs along them, the disparity. Some pixels along the
thread are of no account: what light does to its middle changes as slowly.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import cKDTree

from agents.perception.centrelines.along import Pieces, directions, gaussian, numbered
from agents.perception.centrelines.profiles import normals
from agents.perception.centrelines.refine import tangent_sigma
from schemas.messages import Centrelines
from shared.disparities import Disparities

ROW_PX, DISPARITY_PX = 0.3, 3.0
"""By how much rows of one place differ, and disparities from what those beside them tell: standard deviations."""
ACROSS_PX, ALONG_PX = 3.0, 8.0
"""So far from where it is to be, across and along itself, the right line may lie."""
LEAST = 1e-9


def expected_px(
    certain: Int64[np.ndarray, "k"],
    disparity_px: Float64[np.ndarray, "k"],
    sample: Int64[np.ndarray, "c"],
    piece: Int64[np.ndarray, "n"],
    reach: float = np.inf,
) -> Float64[np.ndarray, "c"]:
    """The disparity of the nearest certain places of the same piece, between them; infinite where none is near.

    Args:
        certain: numbers of samples, in order; sample: those that are asked about.
        piece: of every sample.
        reach: of a certain place, in samples.
    """
    after = np.searchsorted(certain, sample)
    beside = np.stack((np.maximum(after - 1, 0), np.minimum(after, len(certain) - 1)))
    there = certain[beside]
    away = np.abs(sample - there)
    near = (away <= reach) & (piece[there] == piece[sample])
    weight = near / np.maximum(away, 1)
    total = weight.sum(axis=0)
    mean = (weight * disparity_px[beside]).sum(axis=0) / np.maximum(total, LEAST)
    return np.where(total > 0, mean, np.inf)


def carried_on(
    point_px: Float64[np.ndarray, "n 2"],
    piece: Int64[np.ndarray, "n"],
    certain: Int64[np.ndarray, "k"],
    disparity_px: Float64[np.ndarray, "k"],
    right_px: Float64[np.ndarray, "m 2"],
    of_right: Pieces,
    right_normal: Float64[np.ndarray, "m 2"],
) -> tuple[Int64[np.ndarray, "c"], Float64[np.ndarray, "c"]]:
    """The samples of the left lines that get a place so, and where along the right points it lies.

    Args:
        point_px, piece: of every sample.
        certain: numbers of the samples whose places are certain, in order, and their disparities.
    """
    is_rest = np.ones(len(piece), bool)
    is_rest[certain] = False
    rest = is_rest.nonzero()[0]
    disparity = expected_px(certain, disparity_px, rest, piece)
    told = np.isfinite(disparity)
    rest, expected = rest[told], point_px[rest[told]]
    expected[:, 0] -= disparity[told]
    nearest = np.asarray(cKDTree(right_px, balanced_tree=False, compact_nodes=False).query(expected)[1], np.int64)
    normal, off = right_normal[nearest], expected - right_px[nearest]
    ahead, down = normal[:, 1], -normal[:, 0]
    by_row, by_disparity = down / ROW_PX**2, ahead / DISPARITY_PX**2
    step = (by_row * off[:, 1] + by_disparity * off[:, 0]) / (by_row * down + by_disparity * ahead)
    number, at = of_right.number[nearest], nearest + step
    within = (at >= of_right.first[number]) & (at <= of_right.last[number])
    across = np.abs((off * normal).sum(axis=1))
    found = within & (across <= ACROSS_PX) & (np.abs(step) <= ALONG_PX)
    return rest[found], at[found]


EVERY, APART_PX = 4, 8.0
"""Of the left points, which lie a pixel apart, every fourth is asked; of what is known every second place is shown."""
LEAST_ACROSS, LEAST_COSINE = 0.25, 0.8
"""Of a normal, along the row: the row of a thread along the rows says nothing; and between the normals of both eyes."""
OTHERWISE, BESIDE = 3, 3
"""Sampled points: left ones of one strand that meet one place of the right one lie no farther apart; and right points
so near each other count as one place, since the rows of left points lie some pixels apart."""
NEIGHBOURS, ALIKE_PX, UNLIKE_PX, ROUNDS = 12, 2.0, 8.0, 4
"""Certain places within so many sampled points tell the disparity of a place, and of it alone, nearly."""
STEEPEST_PX, LONGEST_STEP = 2.0, 12.0
"""Of the disparity, and of the way along the right line: from one sampled point to the next one, at most."""
SHORTEST = 8
"""Sampled points: less of a thread tells nothing."""


@dataclass(frozen=True)
class SamePlaces:
    """At n places that both eyes see, about every eighth pixel along the left lines.

    Fields:
        left_at: index of the left point.
        right_at: where along the right points, between two of them.
        left_normal, right_normal: unit vectors to the same side of the thread.
        stretches: which places follow each other.
        certain: whether rows tell them, and not the disparity beside them alone; a stretch is of one kind.
    """

    left_at: Int64[np.ndarray, "n"]
    right_at: Float64[np.ndarray, "n"]
    left_normal: Float64[np.ndarray, "n 2"]
    right_normal: Float64[np.ndarray, "n 2"]
    stretches: Pieces
    certain: Bool[np.ndarray, "n"]


@dataclass(frozen=True)
class _Candidates:
    """Right places in the rows of sampled left points, in order of those."""

    sample: Int64[np.ndarray, "c"]
    right_at: Float64[np.ndarray, "c"]
    disparity_px: Float64[np.ndarray, "c"]

    def __getitem__(self, chosen: Int64[np.ndarray, "k"] | Bool[np.ndarray, "c"]) -> "_Candidates":
        return _Candidates(self.sample[chosen], self.right_at[chosen], self.disparity_px[chosen])


def same_places(left: Centrelines, right: Centrelines, reach: Disparities) -> SamePlaces | None:
    """The places of a rectified pair's centrelines that are the same; None where too few are so for certain."""
    if min(len(left.piece), len(right.piece)) < EVERY * SHORTEST:
        return None
    of_left, of_right = Pieces(numbered(left.piece)), Pieces(numbered(right.piece))
    at = np.flatnonzero(of_left.before % EVERY == 0)
    point, piece = left.point_px[at], of_left.number[at]
    found = _in_rows(point, right.point_px, of_right, reach)
    if not len(found.sample):
        return None
    normal, right_normals = _normals(left, of_left)[at], _normals(right, of_right)
    chosen = found[_chosen(found, piece, reach)]
    both = normal[chosen.sample], between(right_normals, chosen.right_at)
    across = np.minimum(*(np.abs(each[:, 0]) for each in both))
    certain = chosen[(across > LEAST_ACROSS) & (_cosine(both) > LEAST_COSINE)]
    certain, _ = _long(certain, _stretches(certain, piece, of_right))
    if not len(certain.sample):
        return None
    sample, right_at = carried_on(
        point, piece, certain.sample, certain.disparity_px, right.point_px, of_right, right_normals
    )
    disparity = point[sample, 0] - between(right.point_px, right_at)[:, 0]
    places = _together(certain, _Candidates(sample, right_at, disparity))
    places = places[_cosine((normal[places.sample], between(right_normals, places.right_at))) > LEAST_COSINE]
    # a stretch is of one kind: what is seen along the rows, and how far it can be told, is another matter
    is_certain = np.zeros(len(at), bool)
    is_certain[certain.sample] = True
    places, number = _long(places, _stretches(places, 2 * piece + is_certain, of_right))
    if not len(places.sample):
        return None
    # what the eyes show there is told by half of the points that tell what is the same
    some, stretches = Pieces(number).every_second
    places = places[some]
    left_normal, right_normal = normal[places.sample], between(right_normals, places.right_at)
    # the right line may have been followed from its other end
    right_normal = right_normal * np.sign((left_normal * right_normal).sum(axis=1))[:, None]
    return SamePlaces(
        at[places.sample], places.right_at, left_normal, right_normal, stretches, is_certain[places.sample]
    )


def _normals(lines: Centrelines, pieces: Pieces) -> Float64[np.ndarray, "n 2"]:
    return normals(directions(lines.point_px, pieces, gaussian(tangent_sigma(float(np.median(lines.width_px))))))


def _cosine(normal: tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]) -> Float64[np.ndarray, "n"]:
    """Of the angle between both eyes' lines, whichever end they were followed from."""
    return np.abs((normal[0] * normal[1]).sum(axis=1))


def between(values: Float64[np.ndarray, "m d"], at: Float64[np.ndarray, "c"]) -> Float64[np.ndarray, "c d"]:
    """Values at places between two of a piece."""
    before = np.minimum(at.astype(np.int64), len(values) - 2)
    share = (at - before)[:, None]
    return values.take(before, axis=0) * (1 - share) + values.take(before + 1, axis=0) * share


def _in_rows(
    point: Float64[np.ndarray, "n 2"], right_px: Float64[np.ndarray, "m 2"], of_right: Pieces, reach: Disparities
) -> _Candidates:
    """Where the right lines meet the row of each point, at a disparity that can be."""
    order = np.argsort(point[:, 1], kind="stable")
    rows = point[order, 1]
    begin = np.flatnonzero(of_right.number[1:] == of_right.number[:-1])
    here, ahead = right_px[begin, 1], right_px[begin + 1, 1]
    low, high = np.minimum(here, ahead), np.maximum(here, ahead)
    first, last = np.searchsorted(rows, low), np.searchsorted(rows, high)
    count = last - first
    segment = np.repeat(begin, count)
    within = np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)
    sample = order[np.repeat(first, count) + within]
    start, step = right_px[segment], right_px[segment + 1] - right_px[segment]
    share = (point[sample, 1] - start[:, 1]) / step[:, 1]
    disparity = point[sample, 0] - (start[:, 0] + share * step[:, 0])
    may_be = np.flatnonzero((disparity > reach.least_px) & (disparity < reach.most_px))
    may_be = may_be[np.argsort(sample[may_be], kind="stable")]
    return _Candidates(sample[may_be], segment[may_be] + share[may_be], disparity[may_be])


def _chosen(found: _Candidates, piece: Int64[np.ndarray, "n"], reach: Disparities) -> Bool[np.ndarray, "c"]:
    """Which candidates are meant for certain, by themselves or by those beside them."""
    chosen = _alone(found)
    if chosen.any():
        chosen &= np.abs(found.disparity_px - np.median(found.disparity_px[chosen])) < reach.about_px
    for _ in range(ROUNDS):
        told = np.zeros(len(piece), bool)
        told[found.sample[chosen]] = True
        rest = np.flatnonzero(~told[found.sample])
        if not chosen.any() or not len(rest):
            break
        sample = found.sample[rest]
        sure = found[chosen]
        expected = expected_px(sure.sample, sure.disparity_px, sample, piece, NEIGHBOURS)
        off = np.abs(found.disparity_px[rest] - expected)
        nearest, second = _two_least(off, sample)
        more = rest[(off == nearest) & (off < ALIKE_PX) & (second > UNLIKE_PX)]
        if not len(more):
            break
        chosen[more] = True
    return chosen


def _alone(found: _Candidates) -> Bool[np.ndarray, "c"]:
    """Whether a left point has no other right place in its row, and that no left one of another strand."""
    once = np.bincount(found.sample)[found.sample] == 1
    segment = found.right_at.astype(np.int64)
    count = int(segment.max()) + 1
    own_least, own_most = np.full(count + 2 * BESIDE, np.iinfo(np.int64).max), np.full(count + 2 * BESIDE, -1)
    np.minimum.at(own_least, segment + BESIDE, found.sample)
    np.maximum.at(own_most, segment + BESIDE, found.sample)
    # with those beside each place: whole arrays take far less time than places one by one
    least, most = own_least[:count].copy(), own_most[:count].copy()
    for beside in range(1, 2 * BESIDE + 1):
        np.minimum(least, own_least[beside : beside + count], out=least)
        np.maximum(most, own_most[beside : beside + count], out=most)
    return once & (most[segment] - least[segment] <= OTHERWISE)


def _two_least(
    off: Float64[np.ndarray, "c"], sample: Int64[np.ndarray, "c"]
) -> tuple[Float64[np.ndarray, "c"], Float64[np.ndarray, "c"]]:
    """Of all candidates of each one's sampled point, the least value and the one after it."""
    begins = np.ones(len(sample), bool)
    np.not_equal(sample[1:], sample[:-1], out=begins[1:])
    first, number = begins.nonzero()[0], begins.cumsum() - 1
    nearest = np.minimum.reduceat(off, first)[number]
    is_nearest = off == nearest
    second = np.minimum.reduceat(np.where(is_nearest, np.inf, off), first)[number]
    alone = np.add.reduceat(is_nearest, first, dtype=np.int64)[number] == 1
    return nearest, np.where(alone, second, nearest)


def _together(one: _Candidates, other: _Candidates) -> _Candidates:
    """Both, in order of the samples."""
    order = np.argsort(np.concatenate((one.sample, other.sample)), kind="stable")
    return _Candidates(
        np.concatenate((one.sample, other.sample))[order],
        np.concatenate((one.right_at, other.right_at))[order],
        np.concatenate((one.disparity_px, other.disparity_px))[order],
    )


def _stretches(places: _Candidates, piece: Int64[np.ndarray, "n"], of_right: Pieces) -> Int64[np.ndarray, "k"]:
    """Numbers of the stretches of places, cut wherever either line, the piece's number or the disparity leaps."""
    left, right = piece[places.sample], of_right.number[places.right_at.astype(np.int64)]
    steps = places.sample[1:] - places.sample[:-1]
    cut = (
        (steps > 2)
        | (left[1:] != left[:-1])
        | (right[1:] != right[:-1])
        | (np.abs(places.right_at[1:] - places.right_at[:-1]) > LONGEST_STEP * steps)
        | (np.abs(places.disparity_px[1:] - places.disparity_px[:-1]) > STEEPEST_PX * steps)
    )
    return np.concatenate(([0], np.cumsum(cut)))[: len(places.sample)]


def _long(places: _Candidates, number: Int64[np.ndarray, "k"]) -> tuple[_Candidates, Int64[np.ndarray, "j"]]:
    """Those of stretches that are long enough, numbered anew."""
    long = np.bincount(number, minlength=1)[number] >= SHORTEST
    return places[long], numbered(number[long])
