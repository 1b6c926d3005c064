"""Where both eyes are to look for the thread: the newest curve in space, brought to where it was seen last.

1. The curve is projected into each eye, and cut where the image ends and where it crosses itself.
2. Each place takes the colours of the nearest point that was observed last, and moves onto its line; places that were
   hidden move as their neighbours do. So a curve that is some frames old is no worse than a new one.
3. What was observed last and is none of the curve stays as it was. Without a curve that is all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import cKDTree

from agents.perception.centrelines.along import STRIDE, Pieces, directions, evenly_spaced, gaussian
from agents.perception.centrelines.profiles import normals
from agents.perception.following.appearance import EVERY, Colours, pieces_of, some_of_observed
from agents.perception.following.capture import BAND_PX
from schemas.messages import Centrelines, RectifiedStereo, ThreadReconstruction, ThreadTrack, Trail
from shared.camera import project
from shared.splines import basis_matrix

DEGREE = 3
SAMPLES = 200
"""Of the curve, before places are spread evenly over its image, EVERY pixels apart as those whose colours are known."""
DIRECTION_PX = 10.0
"""A right angle between directions counts as twice this distance, so that strands that cross are told apart."""
ALIKE = 0.8
"""The cosine of two directions that are one."""
CUT_WIDTHS = 1.5
"""So near to a strand that crosses, profiles hold that as well."""
OTHER_STRAND_WIDTHS = 4.0
"""Along the curve: what is farther away is another strand."""
MARGIN_PX = 3.0
CALM = 5
"""Places in whose middle a motion lies that counts; a place that has found another strand is none of them."""
SHORTEST_PX = 12.0
"""Of a piece: less has no direction of its own."""
DIRECTION_ALONG = 1.0
"""Deviation, in places that lie EVERY pixels apart, of the averages that directions are taken of."""
NEAR_PX = 4.0
"""So near to the curve, or within CUT_WIDTHS, what was observed is part of it."""
LONGEST_WIDTHS = 20.0
"""Of the image: a curve that is longer in it is no thread."""
NOWHERE = np.full((1, 2), -1e6)


@dataclass(frozen=True)
class Expected:
    """Where one eye is to look.

    Fields:
        lines: pieces of points STRIDE pixels apart, with the width that each was last seen with.
        trail: their colours, and what their ends are.
        reach_px: how far to either side of each point its thread may lie: half the way to the next strand.
        was_seen: whether what lay beside the thread was seen there last, at the points whose colours are known.
    """

    lines: Centrelines
    trail: Trail
    reach_px: Float64[np.ndarray, "n"]
    was_seen: Bool[np.ndarray, "m"]


@dataclass(frozen=True)
class _Observed:
    """What one eye saw last, at the points whose colours are known."""

    lines: Centrelines
    trail: Trail
    some: Int64[np.ndarray, "m"]
    pieces: Pieces
    tangent: Float64[np.ndarray, "m 2"]

    @property
    def point(self) -> Float64[np.ndarray, "m 2"]:
        """Where they were."""
        return self.lines.point_px[self.some]

    @property
    def width(self) -> float:
        """Of the thread in general."""
        return float(np.median(self.lines.width_px))


def expected(
    camera: RectifiedStereo,
    last: Sequence[tuple[Centrelines, Trail]],
    thread: ThreadReconstruction | None,
    last_ns: int,
    now_ns: int,
) -> tuple[Expected, ...] | str:
    """Where the eyes are to look for what they saw last and for the curve; or why nothing tells.

    Args:
        last: what each eye observed, as observations send it.
        thread: the newest curve; None, or one without a track, where there is none.
        last_ns, now_ns: when that was, and when the eyes look, by the camera's clock.
    """
    seen = [_observed(*each) for each in last]
    for each in seen:
        if len(each.some) == 0:
            return "no pieces"
        if len(each.some) != len(each.trail.colour_bgr):
            return "points as older versions sent them"
    curves = None if thread is None or thread.track is None else _curves(thread.track, camera, (last_ns, now_ns))
    if curves is None:
        pieces = [_others(each, NOWHERE) for each in seen]
    else:
        pieces = [_pieces(each, a, b - a, camera) for each, a, b in zip(seen, *curves, strict=True)]
    return tuple(_joined(some) for some in pieces) if all(pieces) else "no piece is long enough"


def _curves(
    track: ThreadTrack, camera: RectifiedStereo, moments_ns: tuple[int, ...]
) -> list[tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]] | None:
    """The curve at some moments, moving on as it did, in the left and right image; None where it leaves their front."""
    basis = basis_matrix(track.knots, DEGREE, np.linspace(0.0, 1.0, SAMPLES))
    point, velocity = basis @ track.control_points_camera, np.zeros(3)
    if track.velocity_camera is not None:
        velocity = basis @ track.velocity_camera
    curves: list[tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]] = []
    for at_ns in moments_ns:
        there = point + 1e-9 * (at_ns - track.stamp.capture_left_ns) * velocity
        if (there[:, 2] <= 0).any():
            return None
        curves.append(_projected(there, track, camera))
        if not all(_length_px(curve) < LONGEST_WIDTHS * camera.image_width for curve in curves[-1]):
            return None
    return curves


def _projected(
    point: Float64[np.ndarray, "n 3"], track: ThreadTrack, camera: RectifiedStereo
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]:
    """Points in the left and right image, whose rows are apart as the track says."""
    left, right = project(camera, point)
    lower = np.full(len(point), track.row_offset_px)
    if track.row_slopes_px is not None:
        x, y = ((left - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)).T
        lower += np.column_stack((x, y, x * y)) @ track.row_slopes_px
    half = 0.5 * lower[:, None] * (0.0, 1.0)
    return left - half, right + half


def _length_px(curve: Float64[np.ndarray, "n 2"]) -> float:
    return float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())


def _shares(curve: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n"]:
    """Of its length, where each point of a polyline lies."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    return along / max(along[-1], 1e-9)


def _observed(lines: Centrelines, trail: Trail) -> _Observed:
    pieces = pieces_of(lines)
    some = some_of_observed(pieces)
    sampled = Pieces(pieces.number[some])
    return _Observed(lines, trail, some, sampled, directions(lines.point_px[some], sampled, gaussian(DIRECTION_ALONG)))


def _pieces(
    seen: _Observed, curve: Float64[np.ndarray, "n 2"], motion: Float64[np.ndarray, "n 2"], camera: RectifiedStereo
) -> "list[_Piece]":
    """What one eye is to look for: pieces of the curve, and others that it saw.

    Args:
        curve: when it last looked; motion: of its points since.
    """
    width = seen.width
    place, whole = evenly_spaced(curve, Pieces(np.zeros(len(curve), np.int64)), EVERY)
    motion = np.column_stack([np.interp(np.linspace(0, 1, len(place)), _shares(curve), part) for part in motion.T])
    tangent = directions(place, whole, gaussian(DIRECTION_ALONG))
    nearest, found = _nearest(place, tangent, seen)
    if not found.any():
        return _others(seen, NOWHERE)
    anchored = np.flatnonzero(found)
    place = place + _calm_move(place, tangent, seen.point[nearest], anchored)
    then, place = place, place + motion
    # a place that was hidden takes after the nearest one that was not
    beside = np.rint(np.interp(np.arange(len(place)), anchored, np.arange(len(anchored)))).astype(np.int64)
    of_seen = nearest[anchored[beside]]
    size = np.array((camera.image_width, camera.image_height))
    inside = ((place >= MARGIN_PX) & (place <= size - 1 - MARGIN_PX)).all(axis=1)
    apart_px = _apart_px(place, width)
    cut = apart_px < max(CUT_WIDTHS * width, EVERY)
    runs = _runs(inside & ~cut, round(SHORTEST_PX / EVERY))
    of_curve = [_of_curve(place, of_seen, found, cut, apart_px, run, seen) for run in runs]
    others = _others(seen, then)
    if not others:
        return of_curve
    tree = cKDTree(np.concatenate([other.point for other in others]))
    apart = [np.minimum(part.apart_px, tree.query(part.point)[0]) for part in of_curve]
    return [*(replace(part, apart_px=px) for part, px in zip(of_curve, apart, strict=True)), *others]


def _nearest(
    place: Float64[np.ndarray, "n 2"], tangent: Float64[np.ndarray, "n 2"], seen: _Observed
) -> tuple[Int64[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """The observed point that each place of the curve was, and whether there is one."""
    tree = cKDTree(np.column_stack((seen.point, DIRECTION_PX * _double_angle(seen.tangent))))
    nearest = np.asarray(tree.query(np.column_stack((place, DIRECTION_PX * _double_angle(tangent))))[1])
    off = seen.point[nearest] - place
    along = np.abs((off * tangent).sum(axis=1))
    alike = np.abs((tangent * seen.tangent[nearest]).sum(axis=1)) > ALIKE
    # observed points lie as far apart as places
    return nearest, alike & (np.linalg.norm(off, axis=1) < BAND_PX) & (along < EVERY + 1)


def _double_angle(tangent: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    u, v = tangent.T
    return np.column_stack((u * u - v * v, 2 * u * v))


def _calm_move(
    place: Float64[np.ndarray, "n 2"],
    tangent: Float64[np.ndarray, "n 2"],
    target: Float64[np.ndarray, "n 2"],
    anchored: Int64[np.ndarray, "a"],
) -> Float64[np.ndarray, "n 2"]:
    """By how much places move across the curve onto what was observed, the others as their neighbours."""
    normal = normals(tangent)
    across = ((target - place) * normal).sum(axis=1)[anchored]
    beside = (np.arange(len(across)) + np.arange(CALM)[:, None] - CALM // 2).clip(0, len(across) - 1)
    calm = np.median(across[beside], axis=0)
    return np.interp(np.arange(len(place)), anchored, calm)[:, None] * normal


def _apart_px(place: Float64[np.ndarray, "n 2"], width: float) -> Float64[np.ndarray, "n"]:
    """How near another strand of the curve is, up to twice the band: what lies farther away along it."""
    nearest = np.full(len(place), 2.0 * BAND_PX)
    pairs = cKDTree(place).query_pairs(2.0 * BAND_PX, output_type="ndarray")
    pairs = pairs[EVERY * (pairs[:, 1] - pairs[:, 0]) > OTHER_STRAND_WIDTHS * width]
    off = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1)
    for side in (0, 1):
        np.minimum.at(nearest, pairs[:, side], off)
    return nearest


def _runs(where: Bool[np.ndarray, "n"], least: int) -> list[slice]:
    """Stretches of at least so many places in a row."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], where, [False])).astype(np.int8)))
    return [slice(a, b) for a, b in edges.reshape(-1, 2).tolist() if b - a >= least]


@dataclass(frozen=True)
class _Piece:
    """One stretch to look along.

    Fields:
        colours, was_seen: at every second point and the last one.
        loose, told: of both ends, whether no other strand cuts there, and whether the thread itself may end.
        apart_px: how near another strand lies, as far as that counts.
    """

    point: Float64[np.ndarray, "n 2"]
    width_px: Float64[np.ndarray, "n"]
    colours: Colours
    was_seen: Bool[np.ndarray, "m"]
    loose: tuple[bool, bool]
    told: tuple[bool, bool]
    apart_px: Float64[np.ndarray, "n"]


def _of_curve(
    place: Float64[np.ndarray, "n 2"],
    of_seen: Int64[np.ndarray, "n"],
    found: Bool[np.ndarray, "n"],
    cut: Bool[np.ndarray, "n"],
    apart_px: Float64[np.ndarray, "n"],
    run: slice,
    seen: _Observed,
) -> _Piece:
    """A run of places of the curve, each with what the observed point that it takes after looked like."""
    first, last = run.start, run.stop - 1
    ends = first == 0, last == len(place) - 1
    # past the image's border thread goes on as past a loose end: only a strand that crosses cuts it
    loose = ends[0] or not bool(cut[first - 1]), ends[1] or not bool(cut[last + 1])
    of = of_seen[run]
    values = np.column_stack((place[run], seen.lines.width_px[seen.some][of], apart_px[run]))
    between = np.arange(0, len(of) - 1 + 1e-9, STRIDE / EVERY)
    u, v, width_px, apart = (np.interp(between, np.arange(len(of)), column) for column in values.T)
    return _Piece(np.column_stack((u, v)), width_px, seen.trail.colour_bgr[of], found[run], loose, ends, apart)


def _others(seen: _Observed, place: Float64[np.ndarray, "n 2"]) -> list[_Piece]:
    """What was observed that is no part of the curve, which lies at these places."""
    away_px = np.asarray(cKDTree(place).query(seen.point)[0])
    away = away_px > max(CUT_WIDTHS * seen.width, NEAR_PX)
    parts: list[_Piece] = []
    trail, pieces = seen.trail, seen.pieces
    for k, (a, b) in enumerate(zip(pieces.first.tolist(), pieces.last.tolist(), strict=True)):
        for run in _runs(away[a : b + 1], round(SHORTEST_PX / EVERY) + 1):
            first, last = a + run.start, a + run.stop - 1
            dense = slice(int(seen.some[first]), int(seen.some[last]) + 1)
            starts, ends = first == a, last == b
            loose = bool(starts and trail.loose_start[k]), bool(ends and trail.loose_end[k])
            told = bool(starts and trail.told_start[k]), bool(ends and trail.told_end[k])
            colours, known = trail.colour_bgr[first : last + 1], np.ones(last + 1 - first, bool)
            point, width_px = seen.lines.point_px[dense], seen.lines.width_px[dense]
            apart_px = np.interp(np.arange(dense.start, dense.stop), seen.some, away_px)
            parts.append(_Piece(point, width_px, colours, known, loose, told, apart_px))
    return parts


def _joined(parts: Sequence[_Piece]) -> Expected:
    """Pieces as one message's lines; no other strand's thread lies within reach of any."""
    count = [len(part.point) for part in parts]
    point = np.concatenate([part.point for part in parts])
    (loose_start, loose_end), (told_start, told_end) = (
        np.array(ends).T for ends in ([part.loose for part in parts], [part.told for part in parts])
    )
    width_px = np.concatenate([part.width_px for part in parts])
    colours = np.concatenate([part.colours for part in parts])
    length_px = STRIDE * (np.array(count, np.float64) - 1)
    return Expected(
        Centrelines(point, np.repeat(np.arange(len(parts)), count), width_px, np.ones(len(point))),
        Trail(loose_start, loose_end, length_px, colours, told_start, told_end),
        np.minimum(0.5 * np.concatenate([part.apart_px for part in parts]), BAND_PX),
        np.concatenate([part.was_seen for part in parts]),
    )
