"""The points of both centrelines, each with the parameter of the curve that it is a sighting of.

Between the matches of a piece of the right centreline its points are interpolated. Past them it may show other thread,
or what hides it in the left image; but thread along the rows has no matches, since its crossings with them say nothing.
There both images show it going on in the same rows.

**Beside a cover**: where something covers one side of a thread, its middle is not in the middle of what is seen.

A cover that hides m pixels of a thread's width moves the middle of the rest by m / 2 to the other side. That happens
at the ends of pieces, where the thread goes under a tool or under its own strand at a small angle, and there it looks
narrower than a little farther in. A thread's own tip is narrower too, but on both sides: its middle stays on the way
that the thread has come. So the error is half of what is missing, times how far the middle follows that to one side.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.reconstruction.refined.alignment import STEEP, Alignment, piece_ends, runs, slopes
from agents.reconstruction.refined.paths import Chain
from agents.reconstruction.refined.projection import DENSE, Curve, chords, even_parameters, pixels_evenly, projected
from schemas.messages import Centrelines, Image, Occluders, RectifiedStereo
from shared.images import ImageDataError, decode_image
from shared.occluded import hidden_ends, is_occluded

MOST_POINTS = 420
"""Of each eye: more points of the same length say little more, since neighbours err together."""
CORRELATED_PX = 6.0
"""Along a centreline, over so many pixels its errors are about the same."""
LONGEST_STEP_SPANS = 2.0
FOLD_FACTOR, FOLD_PX, MEDIAN_POINTS = 3.0, 8.0, 9
"""Of the way along the projected curve between the places of neighbouring points, against their distance."""


@dataclass(frozen=True)
class Sightings:
    """Points of both images with their place on the curve.

    Fields:
        deviation_px: of each point across the thread, for points that err independently.
        eye: 0 for the left image, 1 for the right.
        s: parameter of the curve.
        is_end: the thread ends here, so the point holds the curve along itself as well.
        width_px: of the thread, in the median.
        raised: by which factor deviations are more than perception states, since neighbours err together.
    """

    point_px: Float64[np.ndarray, "n 2"]
    deviation_px: Float64[np.ndarray, "n"]
    eye: Int64[np.ndarray, "n"]
    s: Float64[np.ndarray, "n"]
    is_end: Bool[np.ndarray, "n"]
    width_px: float = 0.0
    raised: Float64[np.ndarray, "n"] | float = 1.0


def sightings(left: Chain, right: Centrelines, aligned: Alignment) -> Sightings:
    """The left chain's points, and those of the right pieces between and beside their matched ones."""
    index, s = _of_left(left)
    last = len(left.point_px) - 1
    stride = _stride(len(left.point_px))
    pieces = np.unique(right.piece[aligned.right_index.astype(int)])
    parts = [of_right(int(piece), left, right, aligned, stride) for piece in pieces]
    right_index = np.concatenate([part[0] for part in parts])
    correlated = float(np.sqrt(max(1.0, CORRELATED_PX / _spacing(left.along_px[index]))))
    return Sightings(
        np.concatenate((left.point_px[index], right.point_px[right_index])),
        np.concatenate((left.deviation_px[index], right.deviation_px[right_index])) * correlated,
        np.repeat([0, 1], [len(index), len(right_index)]),
        np.concatenate((s, *(part[1] for part in parts))),
        np.concatenate(((index == 0) | (index == last), *(part[2] for part in parts))),
        float(np.median(left.width_px)),
        correlated,
    )


def left_sightings(point_px: Float64[np.ndarray, "n 2"], s: Float64[np.ndarray, "n"]) -> Sightings:
    """Points of the left image alone, to be placed on a curve."""
    n = len(s)
    return Sightings(point_px, np.ones(n), np.zeros(n, np.int64), s, np.zeros(n, bool))


def parameters_of_course(start: Sightings, now: Sightings, share: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """Parameters of the refined curve where the left chain has these shares of its length behind it.

    `start` holds the left points at their shares, `now` the same points on the refined curve.
    """
    left = start.eye == 0
    return np.interp(share, start.s[left], np.maximum.accumulate(now.s[left]))


def placed(
    sight: Sightings, curve: Curve, camera: RectifiedStereo, row_offset_px: Float64[np.ndarray, "4"], rounds: int = 1
) -> Sightings:
    """The same sightings at the parameters nearest to them, by Newton steps along the projected curve."""
    limit, s = LONGEST_STEP_SPANS / curve.spans, sight.s
    for _ in range(rounds):
        view = projected(curve, s, sight.eye, camera, row_offset_px)
        velocity, off = view.velocity_px, sight.point_px - view.point_px
        square = np.einsum("ni,ni->n", velocity, velocity)
        step = np.einsum("ni,ni->n", velocity, off) / np.maximum(square, 1e-12)
        moved = np.minimum(np.maximum(s + np.minimum(np.maximum(step, -limit), limit), 0.0), 1.0)
        s = np.where(sight.is_end, s, moved)
    return replace(sight, s=s)


def folds(sight: Sightings, curve: Curve, camera: RectifiedStereo) -> Float64[np.ndarray, "f 2"]:
    """Intervals of s where the curve leaves the thread in an image and comes back: a long way between places side by
    side.

    Where a thread runs along the rows, or ends, nothing else keeps a curve from going too far and returning.
    """
    left, right = np.flatnonzero(sight.eye == 0), np.flatnonzero(sight.eye == 1)
    # in order along the chain; single points that are misplaced do not count
    left = left[: 1 + int(np.argmax(sight.s[left]))] if len(left) else left
    places = sight.s[left]
    # which changes nothing where they rise
    if (places[1:] < places[:-1]).any():
        places = scipy.ndimage.median_filter(places, MEDIAN_POINTS, mode="nearest")
    found = _folds(np.maximum.accumulate(places), 0, curve, camera)
    # what the right image alone shows of an end is a place of the curve as good as any
    found_right = _folds(np.sort(sight.s[right]), 1, curve, camera)
    return _joined(np.concatenate((found, found_right)))


def _folds(s: Float64[np.ndarray, "n"], eye: int, curve: Curve, camera: RectifiedStereo) -> Float64[np.ndarray, "f 2"]:
    """Of one eye, between neighbours of these places in order."""
    if len(s) < 2:
        return np.zeros((0, 2))
    dense = even_parameters(curve.spans, DENSE)
    seen = pixels_evenly(curve, DENSE, eye, camera)
    along_px = np.concatenate(([0.0], np.cumsum(chords(seen))))
    placed_px = np.column_stack([np.interp(s, dense, seen[:, axis]) for axis in (0, 1)])
    apart_px = chords(placed_px)
    way_px = np.diff(np.interp(s, dense, along_px))
    far = np.flatnonzero(way_px > FOLD_FACTOR * apart_px + FOLD_PX)
    return np.column_stack((s[far], s[far + 1]))


def _joined(intervals: Float64[np.ndarray, "f 2"]) -> Float64[np.ndarray, "g 2"]:
    """The same stretches as intervals that do not overlap, in order."""
    if len(intervals) < 2:
        return intervals
    low, high = intervals[np.argsort(intervals[:, 0], kind="stable")].T
    reach = np.maximum.accumulate(high)
    first = np.concatenate(([0], 1 + np.flatnonzero(low[1:] > reach[:-1])))
    return np.column_stack((low[first], np.maximum.reduceat(high, first)))


def _spacing(along_px: Float64[np.ndarray, "n"]) -> float:
    return max(1.0, float(np.median(np.diff(along_px)))) if len(along_px) > 1 else 1.0


def _stride(count: int) -> int:
    return max(2, -(-count // MOST_POINTS))


def _of_left(left: Chain) -> tuple[Int64[np.ndarray, "k"], Float64[np.ndarray, "k"]]:
    last = len(left.point_px) - 1
    index = np.append(np.arange(0, last, _stride(last)), last)
    return index, left.along_px[index] / left.along_px[-1]


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


REACH_WIDTHS = 20.0
"""Over so much of a piece its usual width is told."""
WHOLE_WIDTHS = 10.0
"""A piece that has its usual width over less than this may be covered all along: the thread's width counts."""
NARROWER = 0.95
"""Of that: what is less may be covered."""
BEFORE_WIDTHS = 4.0
"""Over so much of the thread farther in its way is told, and over as much as is narrower."""
FEWEST_BEFORE = 4
DOUBT = 0.15
"""How well the way tells the share of what is missing by which the middle moves."""


def with_covered_ends(lines: Centrelines) -> Centrelines:
    """The same centrelines, with the error that a cover may cause in the deviations of points at the pieces' ends."""
    error, whole = np.zeros(len(lines.piece)), float(np.median(lines.width_px)) if len(lines.width_px) else 0.0
    for piece in np.split(np.arange(len(lines.piece)), np.flatnonzero(np.diff(lines.piece)) + 1):
        for inwards in (piece, piece[::-1]):
            found = _errors_px(lines.point_px[inwards], lines.width_px[inwards], whole)
            error[inwards[: len(found)]] = np.maximum(error[inwards[: len(found)]], found)
    return replace(lines, deviation_px=np.hypot(lines.deviation_px, error))


@dataclass(frozen=True)
class Hidden:
    """What occluders hide of a curve.

    Fields:
        places: which of some places along it they hide.
        ends: whether the curve may go on, hidden, at its first and at its last end.
    """

    places: Bool[np.ndarray, "n"]
    ends: Bool[np.ndarray, "2"]


def hidden_of(
    pixels: tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]],
    unseen: Bool[np.ndarray, "n"],
    occluders: Occluders | None,
    image_width: int,
) -> Hidden | None:
    """What occluders hide of a curve; None where nobody knows of any.

    Args:
        pixels: places along the curve, in order, in the left and in the right image.
        unseen: which of these not both images show.
    """
    if occluders is None:
        return None
    maps = map_of(occluders.left), map_of(occluders.right)
    if maps[0] is None or maps[1] is None:
        return None
    places, ends = np.zeros(len(unseen), bool), np.zeros(2, bool)
    for line_px, found in zip(pixels, maps, strict=True):
        if found is None or not found.any():
            continue
        places |= is_occluded(line_px, found, image_width)
        ends |= hidden_ends(line_px, found, image_width)
    return Hidden(places & unseen, ends)


@lru_cache(maxsize=4)
def map_of(image: Image) -> UInt8[np.ndarray, "r c"] | None:
    """A map of occluders, None where it cannot be read.

    Instruments are looked for anew every some frames only, and those between send the same maps.
    """
    try:
        pixels = decode_image(image)
    except ImageDataError:
        return None
    if pixels.ndim != 2:
        return None
    pixels.setflags(write=False)
    return pixels


def _errors_px(
    points: Float64[np.ndarray, "n 2"], width: Float64[np.ndarray, "n"], whole: float
) -> Float64[np.ndarray, "k"]:
    """Of a piece's first points, until it has all of its width; `whole` is that of the thread."""
    if not len(width):
        return np.zeros(0)
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    usual = float(np.median(width[along <= REACH_WIDTHS * np.median(width)]))
    step = np.diff(along, append=along[-1])
    if step[width >= NARROWER * usual].sum() < WHOLE_WIDTHS * whole:
        usual = max(usual, whole)
    narrow = width < NARROWER * usual
    count = len(width) if narrow.all() else int(np.argmin(narrow))
    if count < 2:
        return np.zeros(0)
    half = 0.5 * (usual - width[:count])
    reach = along[count - 1] + max(BEFORE_WIDTHS * usual, float(along[count - 1]))
    before = slice(count, int(np.searchsorted(along, reach)))
    if before.stop - before.start < FEWEST_BEFORE:
        return half
    return half * min(1.0, DOUBT + abs(_one_sided(points, along, half, before)))


def _one_sided(
    points: Float64[np.ndarray, "n 2"],
    along: Float64[np.ndarray, "n"],
    half: Float64[np.ndarray, "k"],
    before: slice,
) -> float:
    """How far the first points lie beside the parabola through those before them, as a multiple of half by which."""
    origin, end = along[before.start], along[before.stop - 1]
    powers = np.vander((along[: before.stop] - origin) / max(end - origin, 1e-9), 3)
    way = np.linalg.lstsq(powers[before], points[before], rcond=None)[0]
    direction = points[before.stop - 1] - points[before.start]
    normal = np.array([-direction[1], direction[0]]) / max(float(np.linalg.norm(direction)), 1e-9)
    side = (points[: len(half)] - powers[: len(half)] @ way) @ normal
    return float(side @ half) / max(float(half @ half), 1e-12)
