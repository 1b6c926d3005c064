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

from agents.reconstruction.refined.cubic import even_parameters
from agents.reconstruction.refined.points import Points, double_angle
from agents.reconstruction.refined.projection import Curve, chords, projected_evenly
from agents.reconstruction.refined.sightings import Sightings
from schemas.messages import RectifiedStereo

REACH_SHARE = 0.034
"""Of the image's width: the farthest motion from frame to frame that is looked for."""
LIKELY_SHARE = 0.03
BIN_SHARE = 0.003
GATE_SHARE = 0.008
"""How far from the shifted curve a point may lie."""
DIRECTION_SHARE = 0.01
"""A right angle between directions counts as twice this distance."""
VOTERS = 80
"""Of each eye, of places and of points."""
SAMPLES_PER_SPAN = 6
LEAP, LEAP_SHARE = 3.0, 0.008
"""Places of neighbours that are farther apart than so many times the points, and this share of the width, are no one
strand's."""
SHORTEST_RUN = 5


@dataclass(frozen=True)
class Associated:
    """Sightings of a predicted curve.

    Fields:
        found_share: of all points of both eyes.
        shown_shares: of the curve, in the left and in the right image.
        hidden_share, alone_share: of the curve, what neither image shows and what one alone shows.
        beyond_px: how far thread goes on past either end of the curve, in the image where it is less.
    """

    sight: Sightings
    found_share: float
    shown_shares: tuple[float, float]
    hidden_share: float
    alone_share: float
    beyond_px: float


@dataclass(frozen=True)
class _Eye:
    point_px: Float64[np.ndarray, "n 2"]
    deviation_px: Float64[np.ndarray, "n"]
    s: Float64[np.ndarray, "n"]
    is_end: Bool[np.ndarray, "n"]
    points: int
    beyond_px: Float64[np.ndarray, "2"]


def associated(
    curve: Curve,
    points: tuple[Points, Points],
    camera: RectifiedStereo,
    row_offset_px: Float64[np.ndarray, "4"],
    votes: bool,
) -> Associated:
    """The points of both eyes with their places on a curve that is some pixels away from them.

    Args:
        votes: whether the curve may be farther away as a whole.
    """
    eyes = [_of_eye(curve, points[eye], eye, camera, row_offset_px, votes) for eye in (0, 1)]
    sight = Sightings(
        np.concatenate([e.point_px for e in eyes]),
        np.concatenate([e.deviation_px for e in eyes]),
        np.repeat([0, 1], [len(e.s) for e in eyes]),
        np.concatenate([e.s for e in eyes]),
        np.concatenate([e.is_end for e in eyes]),
        points[0].width_px,
        np.repeat([points[eye].raised for eye in (0, 1)], [len(e.s) for e in eyes]),
    )
    total = sum(e.points for e in eyes)
    left, right = (_shown(e.s, 2 * curve.spans) for e in eyes)
    beyond = np.minimum(*(e.beyond_px for e in eyes))
    return Associated(
        sight,
        len(sight.s) / max(total, 1),
        (float(left.mean()), float(right.mean())),
        float((~left & ~right).mean()),
        float((left ^ right).mean()),
        float(beyond.max()),
    )


def _shown(s: Float64[np.ndarray, "n"], places: int) -> Bool[np.ndarray, "places"]:
    """Which of so many places of the curve have a point."""
    return np.bincount((s * places).astype(int).clip(0, places - 1), minlength=places) > 0


def _of_eye(
    curve: Curve,
    points: Points,
    eye: int,
    camera: RectifiedStereo,
    row_offset_px: Float64[np.ndarray, "4"],
    votes: bool,
) -> _Eye:
    if not len(points.piece):
        return _Eye(points.point_px, points.deviation_px, np.zeros(0), points.is_end, 0, np.zeros(2))
    at = even_parameters(curve.spans, SAMPLES_PER_SPAN)
    view = projected_evenly(curve, SAMPLES_PER_SPAN, eye, camera, row_offset_px)
    width, found = camera.image_width, points.point_px
    moved = view.point_px + _shift(view.point_px, points.all_px, width) if votes else view.point_px
    nearest = _nearest(moved, view.velocity_px, points, DIRECTION_SHARE * width)
    off, velocity = found - moved[nearest], view.velocity_px[nearest]
    speed = np.sqrt(np.einsum("ni,ni->n", velocity, velocity))
    ahead = np.einsum("ni,ni->n", off, velocity) / np.maximum(speed, 1e-9)
    outside = ((nearest == 0) & (ahead < 0)) | ((nearest == len(at) - 1) & (ahead > 0))
    near = (np.einsum("ni,ni->n", off, off) <= (GATE_SHARE * width) ** 2) & ~outside
    along = np.concatenate(([0.0], np.cumsum(chords(moved))))
    place = along[nearest] + np.where(outside, 0.0, ahead)
    kept = near & _in_order(place, points.piece, near, found, width)
    ends, beyond = _ends(points, kept, place, along[-1], width)
    s = np.where(ends < 0, np.interp(place, along, at), ends)
    return _Eye(found[kept], points.deviation_px[kept], s[kept], (ends >= 0)[kept], len(found), beyond)


def _nearest(
    moved: Float64[np.ndarray, "m 2"], velocity: Float64[np.ndarray, "m 2"], points: Points, weight: float
) -> Int64[np.ndarray, "n"]:
    """The place of the curve nearest to each point, a difference in direction counting as distance."""
    places = np.column_stack((moved, weight * double_angle(velocity)))
    found = np.column_stack((points.point_px, weight * points.direction))
    return np.asarray(cKDTree(places, balanced_tree=False, compact_nodes=False).query(found)[1])


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


def _in_order(
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


def _ends(
    points: Points, kept: Bool[np.ndarray, "n"], place: Float64[np.ndarray, "n"], length_px: float, width: int
) -> tuple[Int64[np.ndarray, "n"], Float64[np.ndarray, "2"]]:
    """Which points are the thread's first (0) or last (1) end, -1 for none, and how far pieces go on past each end."""
    ends, beyond = np.full(len(kept), -1), np.zeros(2)
    if not kept.any():
        return ends, beyond
    for which, value in ((0, 0.0), (1, length_px)):
        inside = np.flatnonzero(kept)
        off = np.abs(place[inside] - value)
        outermost, gap = inside[np.argmin(off)], off.min()
        if gap > 2 * GATE_SHARE * width:
            continue
        tail = _tail(outermost, points.piece, kept)
        end = tail[-1] if len(tail) else outermost
        past = float(chords(points.point_px[np.append(outermost, tail)]).sum())
        if past > 2 * GATE_SHARE * width:
            beyond[which] = past
        elif points.is_end[end]:
            kept[end] = True
            ends[end] = which
    return ends, beyond


def _tail(outermost: int, piece: Int64[np.ndarray, "n"], kept: Bool[np.ndarray, "n"]) -> Int64[np.ndarray, "k"]:
    """The points of the same piece that lie past its outermost kept point, going outward until one is kept again."""
    own = np.flatnonzero(piece == piece[outermost])
    at = int(np.searchsorted(own, outermost))
    side = min((own[:at][::-1], own[at + 1 :]), key=lambda side: int(kept[side].sum()))
    return side[: int(np.argmax(np.append(kept[side], True)))]
