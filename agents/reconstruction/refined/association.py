"""Which place of a predicted curve each point of both centrelines shows, without tracing or aligning anything anew.

1. `shift`: how far each image of the curve has moved as a whole, by a vote of all pairs of a point and a place.
2. The nearest place of the shifted curve for each point, where directions count as well, so that strands that cross
   are told apart.
3. Order: a piece is one strand, so its places follow each other along the curve. Where they leap or turn back, only the
   longest stretches that fit together are kept.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import cKDTree

from agents.reconstruction.refined.points import Points, double_angle
from agents.reconstruction.refined.projection import Curve, chords, even_parameters, projected_evenly
from agents.reconstruction.refined.sightings import Sightings
from schemas.messages import RectifiedStereo

REACH_SHARE = 0.034
"""Of the image's width: the farthest motion from frame to frame that is looked for."""
LIKELY_SHARE = 0.03
BIN_SHARE, LEAST_SHIFT_BINS = 0.003, 1.5
GATE_SHARE = 0.008
"""How far from the shifted curve a point may lie."""
DIRECTION_SHARE = 0.01
"""A right angle between directions counts as twice this distance."""
VOTERS = 80
"""Of each eye, of places and of points."""
SAMPLES_PER_SPAN = 6


@dataclass(frozen=True)
class Associated:
    """Sightings of a predicted curve.

    Fields:
        found_share: of all points of both eyes.
        shown_shares: of the curve, in the left and in the right image.
        hidden_share, alone_share: of the curve, what neither image shows and what one alone shows.
        beyond_px: how far thread goes on past either end of the curve, in the image where it is less.
        farthest_px: how far beside the curve they lie at most, and beyond its ends the thread's.
    """

    sight: Sightings
    found_share: float
    shown_shares: tuple[float, float]
    hidden_share: float
    alone_share: float
    beyond_px: float
    farthest_px: float


@dataclass(frozen=True)
class _Ends:
    """The points that are the thread's first or last end, with s, and how far pieces go on past each end."""

    found: list[tuple[int, float]]
    beyond_px: Float64[np.ndarray, "2"]


@dataclass(frozen=True)
class _Places:
    """The nearest place of the shifted curve for each point, whether it is one or not.

    Fields:
        along_px: along the shifted curve; s: the same as a parameter.
        near: within reach, and not past an end.
        length_px: of the image of the curve in each eye.
        ahead_px: as along_px, and beyond the ends where points lie there.
        beside_px: how far beside the curve, not shifted, each point lies at most.
    """

    along_px: Float64[np.ndarray, "n"]
    s: Float64[np.ndarray, "n"]
    near: Bool[np.ndarray, "n"]
    length_px: tuple[float, float]
    ahead_px: Float64[np.ndarray, "n"]
    beside_px: Float64[np.ndarray, "n"]


def associated(
    curve: Curve, points: Points, camera: RectifiedStereo, row_offset_px: Float64[np.ndarray, "4"], votes: bool
) -> Associated:
    """The points of both eyes with their places on a curve that is some pixels away from them.

    Args:
        votes: whether the curve may be farther away as a whole.
    """
    width = camera.image_width
    places = _places(curve, points, camera, row_offset_px, votes)
    kept = places.near & in_order(places.along_px, points.piece, places.near, points.point_px, width)
    s, is_end = places.s, np.zeros(len(kept), bool)
    left_ends, right_ends = (
        _ends(points, points.of_eye(eye), kept, places.along_px, places.length_px[eye], width) for eye in (0, 1)
    )
    farthest_px = float(places.beside_px[kept].max(initial=0.0))
    for ends, length_px in zip((left_ends, right_ends), places.length_px, strict=True):
        for point, value in ends.found:
            kept[point] = is_end[point] = True
            s[point] = value
            farthest_px = max(farthest_px, abs(float(places.ahead_px[point]) - value * length_px))
    index = np.flatnonzero(kept)
    found, s = int(np.searchsorted(index, points.lefts)), s[index]
    sight = Sightings(
        points.point_px[index],
        points.deviation_px[index],
        np.repeat((0, 1), (found, len(s) - found)),
        s,
        is_end[index],
        points.width_px,
        points.raised[index],
    )
    left, right = (_shown(part, 2 * curve.spans) for part in (s[:found], s[found:]))
    return Associated(
        sight,
        len(s) / max(len(kept), 1),
        (float(left.mean()), float(right.mean())),
        float((~left & ~right).mean()),
        float((left ^ right).mean()),
        float(np.minimum(left_ends.beyond_px, right_ends.beyond_px).max()),
        farthest_px,
    )


def _shown(s: Float64[np.ndarray, "n"], places: int) -> Bool[np.ndarray, "places"]:
    """Which of so many places of the curve have a point."""
    return np.bincount((s * places).astype(int).clip(0, places - 1), minlength=places) > 0


def _places(
    curve: Curve, points: Points, camera: RectifiedStereo, row_offset_px: Float64[np.ndarray, "4"], votes: bool
) -> _Places:
    at, width = even_parameters(curve.spans, SAMPLES_PER_SPAN), camera.image_width
    view = projected_evenly(curve, SAMPLES_PER_SPAN, camera, row_offset_px)
    moved, farther_px = view.point_px, 0.0
    if votes:
        shift = np.stack([_shift(moved[_half(eye, at)], points.all_px[eye], width) for eye in (0, 1)])
        # what is less the pairs do not tell: along a thread that stands still they vote for any neighbour alike
        if np.abs(shift).max() > LEAST_SHIFT_BINS * BIN_SHARE * width:
            moved = moved + np.repeat(shift, len(at), axis=0)
            farther_px = float(np.linalg.norm(shift, axis=1).max())
    nearest = _nearest(moved, view.velocity_px, points, DIRECTION_SHARE * width)
    off, velocity = points.point_px - moved[nearest], view.velocity_px[nearest]
    speed = np.maximum(np.sqrt(np.einsum("ni,ni->n", velocity, velocity)), 1e-9)
    ahead = np.einsum("ni,ni->n", off, velocity) / speed
    of_eye = np.concatenate((nearest[: points.lefts], nearest[points.lefts :] - len(at)))
    outside = ((of_eye == 0) & (ahead < 0)) | ((of_eye == len(at) - 1) & (ahead > 0))
    near = (np.einsum("ni,ni->n", off, off) <= (GATE_SHARE * width) ** 2) & ~outside
    along = np.zeros((2, len(at)))
    for eye in (0, 1):
        np.cumsum(chords(moved[_half(eye, at)]), out=along[eye, 1:])
    ahead += along.ravel()[nearest]
    place = np.where(outside, along.ravel()[nearest], ahead)
    s = np.concatenate([np.interp(place[points.of_eye(eye)], along[eye], at) for eye in (0, 1)])
    beside = np.abs(off[:, 0] * velocity[:, 1] - off[:, 1] * velocity[:, 0]) / speed + farther_px
    return _Places(place, s, near, (along[0, -1], along[1, -1]), ahead, beside)


def _half(eye: int, at: Float64[np.ndarray, "m"]) -> slice:
    """Where what belongs to one eye lies among the places of both."""
    return slice(eye * len(at), (eye + 1) * len(at))


def _nearest(
    moved: Float64[np.ndarray, "m 2"], velocity: Float64[np.ndarray, "m 2"], points: Points, weight: float
) -> Int64[np.ndarray, "n"]:
    """The place of the curve nearest to each point, in the same eye, a difference in direction counting as distance."""
    places = np.column_stack((moved, weight * double_angle(velocity)))
    found, half = np.column_stack((points.point_px, weight * points.direction)), len(places) // 2
    trees = [cKDTree(part, balanced_tree=False, compact_nodes=False) for part in (places[:half], places[half:])]
    return np.concatenate([tree.query(found[points.of_eye(eye)])[1] + eye * half for eye, tree in enumerate(trees)])


def _shift(
    curve_px: Float64[np.ndarray, "m 2"], points: Float64[np.ndarray, "n 2"], width: int
) -> Float64[np.ndarray, "2"]:
    """The translation that carries most places of the curve onto points; smaller ones are likelier."""
    reach, size, likely = REACH_SHARE * width, BIN_SHARE * width, LIKELY_SHARE * width
    if not len(points):
        return np.zeros(2)
    a, b = curve_px[:: max(1, len(curve_px) // VOTERS)], points[:: max(1, len(points) // VOTERS)]
    by_u, by_v = b[:, 0] - a[:, :1], b[:, 1] - a[:, 1:]
    within = (np.abs(by_u) < reach) & (np.abs(by_v) < reach)
    by = np.column_stack((by_u[within], by_v[within]))
    half = int(reach / size) + 2
    side = 2 * half + 1
    bins = np.rint(by / size).astype(int) + half
    votes = np.bincount(bins[:, 0] * side + bins[:, 1], minlength=side * side).reshape(side, side).astype(float)
    # in threes; no vote lies in the outermost bins
    votes[1:-1] = votes[:-2] + votes[1:-1] + votes[2:]
    votes[:, 1:-1] = votes[:, :-2] + votes[:, 1:-1] + votes[:, 2:]
    centre = (np.arange(side) - half) * size
    likelihood = np.exp(-0.5 * centre**2 / likely**2)
    votes *= likelihood[:, None] * likelihood
    i, j = np.unravel_index(int(np.argmax(votes)), votes.shape)
    peak = np.array((centre[i], centre[j]))
    near = by[(np.abs(by - peak) <= 1.5 * size).all(axis=1)]
    return near.mean(axis=0) if len(near) else np.zeros(2)


def _ends(
    points: Points,
    of_eye: slice,
    kept: Bool[np.ndarray, "n"],
    place: Float64[np.ndarray, "n"],
    length_px: float,
    width: int,
) -> _Ends:
    """Those of one eye."""
    ends, far = _Ends([], np.zeros(2)), 2 * GATE_SHARE * width
    inside = np.flatnonzero(kept[of_eye]) + (of_eye.start or 0)
    if not len(inside):
        return ends
    for which, value in enumerate((0.0, length_px)):
        off = np.abs(place[inside] - value)
        number = int(np.argmin(off))
        outermost = int(inside[number])
        if off[number] > far:
            continue
        tail = _tail(outermost, points.piece, kept)
        end = int(tail[-1]) if len(tail) else outermost
        past = float(chords(points.point_px[np.append(outermost, tail)]).sum()) if len(tail) else 0.0
        if past > far:
            ends.beyond_px[which] = past
        elif points.is_end[end]:
            ends.found.append((end, float(which)))
    return ends


def _tail(outermost: int, piece: Int64[np.ndarray, "n"], kept: Bool[np.ndarray, "n"]) -> Int64[np.ndarray, "k"]:
    """The points of the same piece that lie past its outermost kept point, going outward until one is kept again."""
    first, end = (int(np.searchsorted(piece, piece[outermost], side)) for side in ("left", "right"))
    before, after = kept[first:outermost][::-1], kept[outermost + 1 : end]
    backwards = np.count_nonzero(before) <= np.count_nonzero(after)
    side = before if backwards else after
    count = int(np.argmax(side)) if side.any() else len(side)
    return np.arange(outermost - 1, outermost - 1 - count, -1) if backwards else outermost + 1 + np.arange(count)


LEAP, LEAP_SHARE = 3.0, 0.008
"""Places of neighbours that are farther apart than so many times the points, and this share of the width, are no one
strand's."""
SHORTEST_RUN = 5


def in_order(
    place: Float64[np.ndarray, "n"],
    piece: Int64[np.ndarray, "n"],
    near: Bool[np.ndarray, "n"],
    points: Float64[np.ndarray, "n 2"],
    width: int,
) -> Bool[np.ndarray, "n"]:
    """Of each piece, the runs without leap that follow each other in one direction and hold most points."""
    kept = np.zeros(len(place), bool)
    usable = np.flatnonzero(near)
    if not len(usable):
        return kept
    step, at, on = chords(points[usable]), place[usable], piece[usable]
    leap = (np.abs(at[1:] - at[:-1]) > LEAP * step + LEAP_SHARE * width) | (on[1:] != on[:-1])
    bounds = (0, *(np.flatnonzero(leap) + 1), len(usable))
    runs = [usable[first:end] for first, end in pairwise(bounds) if end - first >= SHORTEST_RUN]
    for number in {int(piece[run[0]]) for run in runs}:
        own = [run for run in runs if piece[run[0]] == number]
        ways = (_longest_chain(own, place), _longest_chain(own, -place))
        for run in max(ways, key=lambda way: sum(len(run) for run in way)):
            kept[run] = True
    return kept


def _longest_chain(runs: list[Int64[np.ndarray, "k"]], place: Float64[np.ndarray, "n"]) -> list[Int64[np.ndarray, "k"]]:
    """The runs with rising places of which each begins after the one before, with most points in all."""
    rising = [run for run in runs if place[run[-1]] > place[run[0]]]
    best: list[list[np.ndarray]] = []
    for run in rising:
        before = [way for way in best if place[way[-1][-1]] <= place[run[0]]]
        best.append([*max(before, key=lambda way: sum(len(r) for r in way), default=[]), run])
    return max(best, key=lambda way: sum(len(r) for r in way), default=[])
