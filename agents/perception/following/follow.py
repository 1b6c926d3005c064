"""The thread measured where it is expected, in both eyes at once; or why it is not there.

1. `capture` tells by how far each place has moved across the line, and whether it shows the thread, the ground, or
   something else.
2. Where a stretch shows something else, that hides the thread, and pieces end beside it. Where it shows the ground, the
   thread has left it.
3. `ends` tells where the thread's own ends are now.
4. The rounds by edges and by what is learned are those of every frame, so that nothing adds up from frame to frame.

Both eyes are worked on at once, in one image that holds both (`stacked`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.perception.centrelines.along import STRIDE, Pieces, directions, gaussian
from agents.perception.centrelines.deviation import deviations, of_edges
from agents.perception.centrelines.learned import usual_width_px
from agents.perception.centrelines.profiles import normals
from agents.perception.centrelines.refine import Curves, Evidence, by_edges, by_learning, tangent_sigma
from agents.perception.centrelines.tips import to_tips
from agents.perception.following import capture
from agents.perception.following.appearance import EVERY, Colours, colours_across, pieces_of, some_of, some_of_observed
from agents.perception.following.capture import Captured, captured
from agents.perception.following.ends import REACH_PX, ends_of, with_ends
from agents.perception.following.prediction import Expected
from agents.perception.following.stacked import (
    Eyes,
    StackedLines,
    lines_of,
    stacked_images,
    stacked_lines,
    stacked_trails,
    trail_of_eye,
)
from schemas.messages import Centrelines, Trail

LEAST_CLEAR = 0.25
"""How much more of a profile is thread than of what lies beside it, at least."""
LONGEST_UNCLEAR_WIDTHS = 3.0
"""Stretches that do not show the thread are hidden, and no chance."""
BESIDE_HIDDEN = round(capture.ALONG)
"""Places beside what hides the thread show a part of that, since profiles are averaged along it."""
LEAST_SHOWN = 0.4
"""Of what is expected, in either eye: where less is seen, the thread may be anywhere."""
LEAST_WIDTH, MOST_WIDTH, WIDTH_SHARE = 0.7, 1.4, 0.92
"""Of the width before, and at how many points at least it must be like that."""
LEAST_LENGTH_PX = 3
"""Of a piece: what is shorter has no direction of its own."""
CUT_WIDTHS = 2.5
"""So near to a cut, profiles hold what crosses there too."""
TOLD_PX = 4.0
"""From where thread ends by its mask to where the image shows that it ends."""


@dataclass(frozen=True)
class Followed:
    """Centrelines of one eye, and what the next frame follows them by."""

    lines: Centrelines
    trail: Trail


@dataclass(frozen=True)
class _Strips:
    """Where all eyes are to look, in the image that holds them.

    Fields:
        point: STRIDE pixels apart along pieces; eye: of each piece.
        trail: colours at `some` of the points, and what the pieces' ends are.
        sampled, normal: the pieces and normals of these.
        width: of the thread in general.
        reach_px, was_seen: see `Expected`.
    """

    point: Float64[np.ndarray, "n 2"]
    pieces: Pieces
    eye: Int64[np.ndarray, "k"]
    trail: Trail
    some: Int64[np.ndarray, "m"]
    sampled: Pieces
    normal: Float64[np.ndarray, "m 2"]
    width_px: Float64[np.ndarray, "n"]
    width: float
    reach_px: Float64[np.ndarray, "n"]
    was_seen: Bool[np.ndarray, "m"]

    def between(self, values: Float64[np.ndarray, "m"]) -> Float64[np.ndarray, "n"]:
        """Values at all points from those at some."""
        return np.interp(np.arange(len(self.point)), self.some, values)


@dataclass(frozen=True)
class _Stretches:
    """What of the pieces is seen, by first and last point, and of which piece each is.

    Fields:
        loose_start, loose_end: whether the thread goes on there, hidden, or ends; else a strand crosses.
        told_start, told_end: whether it may be the thread's own end.
    """

    first: Int64[np.ndarray, "k"]
    last: Int64[np.ndarray, "k"]
    piece: Int64[np.ndarray, "k"]
    loose_start: Bool[np.ndarray, "k"]
    loose_end: Bool[np.ndarray, "k"]
    told_start: Bool[np.ndarray, "k"]
    told_end: Bool[np.ndarray, "k"]


def trail_of(
    image: UInt8[np.ndarray, "h w 3"],
    lines: Centrelines,
    loose_start: Bool[np.ndarray, "k"],
    loose_end: Bool[np.ndarray, "k"],
) -> Trail:
    """What the next frame follows centrelines by that were looked for pixel by pixel."""
    pieces = pieces_of(lines)
    some = some_of(pieces)
    if len(some) == 0:
        return Trail(loose_start, loose_end, np.zeros(0), np.zeros((0, 3, 3), np.uint8), loose_start, loose_end)
    width, point, sampled = float(np.median(lines.width_px)), lines.point_px[some], Pieces(pieces.number[some])
    tangent = _tangents(point, sampled, width)
    colours = _colours(image, point, lines.width_px[some], sampled, tangent)
    tips, outward = _tips(sampled, tangent)
    eye = Eyes(image.shape[0], image.shape[1], 1)
    ends = ends_of(image, point[tips], outward, width, colours[tips], eye)
    long = np.tile(lengths_px(pieces) >= 2 * REACH_PX, 2)
    told = np.concatenate((loose_start, loose_end)) & long & ~ends.lost & (np.abs(ends.reach_px) <= TOLD_PX)
    return Trail(loose_start, loose_end, lengths_px(pieces), colours, *np.split(told, 2))


def lengths_px(pieces: Pieces) -> Float64[np.ndarray, "k"]:
    """Of each piece, whose points lie a pixel apart."""
    return (pieces.last - pieces.first).astype(np.float64)


def every_second(lines: Centrelines) -> Centrelines:
    """Every second point of centrelines: neighbours err alike, and the others say hardly more."""
    some, _ = pieces_of(lines).every_second
    return Centrelines(lines.point_px[some], lines.piece[some], lines.width_px[some], lines.deviation_px[some])


def follow(images: Sequence[UInt8[np.ndarray, "h w 3"]], where: Sequence[Expected]) -> tuple[Followed, ...] | str:
    """The centrelines in the next images of some eyes, all of one size; or why the thread is to be looked for.

    Args:
        where: each eye is to look.
    """
    image, eyes = stacked_images(images)
    strips = _strips(where, eyes)
    found = captured(
        image,
        strips.point[strips.some],
        strips.normal,
        strips.width,
        strips.trail.colour_bgr,
        strips.sampled,
        strips.reach_px[strips.some],
        strips.was_seen,
    )
    shown = _shown(found, strips)
    if reason := _lost(found, shown, strips):
        return reason
    stretches = _stretches(strips.between(shown.astype(np.float64)) > 0.5, strips)
    if len(stretches.first) == 0:
        return "no piece is long enough"
    curves, usual, told = _with_ends(image, eyes, strips, found, stretches)
    lines = _refined(image, eyes, curves, usual, strips.width, told)
    if isinstance(lines, str):
        return lines
    pieces = pieces_of(lines)
    some = some_of(pieces)
    point, sampled = lines.point_px[some], Pieces(pieces.number[some])
    colours = _colours(image, point, lines.width_px[some], sampled, _tangents(point, sampled, strips.width))
    trail = Trail(stretches.loose_start, stretches.loose_end, lengths_px(pieces), colours, *np.split(told, 2))
    eye = strips.eye[stretches.piece]
    of_colour = eye[sampled.number]
    return tuple(
        Followed(lines_of(lines, eye, k, eyes), trail_of_eye(trail, eye == k, of_colour == k))
        for k in range(eyes.count)
    )


def _strips(where: Sequence[Expected], eyes: Eyes) -> _Strips:
    lines, eye = stacked_lines([each.lines for each in where], eyes)
    pieces = Pieces(lines.piece)
    some, width = some_of_observed(pieces), float(np.median(lines.width_px))
    sampled = Pieces(pieces.number[some])
    return _Strips(
        lines.point_px,
        pieces,
        eye,
        stacked_trails([each.trail for each in where]),
        some,
        sampled,
        normals(_tangents(lines.point_px[some], sampled, width)),
        lines.width_px,
        width,
        np.concatenate([each.reach_px for each in where]),
        np.concatenate([each.was_seen for each in where]),
    )


def _lost(found: Captured, shown: Bool[np.ndarray, "m"], strips: _Strips) -> str:
    """Why the thread may be elsewhere; empty where it is not."""
    of_eye = strips.eye[strips.sampled.number]
    if min(float(shown[of_eye == k].mean()) for k in range(int(of_eye.max()) + 1)) < LEAST_SHOWN:
        return "most of the thread is not seen where it is expected"
    # the ends slide by so much, and bare the ground
    longest = max(_longest_unclear(strips.width), round(REACH_PX / EVERY)) + 1
    bare = found.bare & (found.clear < LEAST_CLEAR) & _counts(strips)
    if _long_runs(bare, strips.sampled, longest).any():
        return "the ground shows where the thread was"
    return ""


def _longest_unclear(width: float) -> int:
    """How many places in a row may fail to show the thread by chance."""
    return max(2, round(LONGEST_UNCLEAR_WIDTHS * width / EVERY))


def _shown(found: Captured, strips: _Strips) -> Bool[np.ndarray, "m"]:
    """Which places show the thread: all but those in, and close beside, longer stretches that do not."""
    pieces = strips.sampled
    bad = _as_beside((found.clear < LEAST_CLEAR) | found.astray, _counts(strips), pieces)
    hidden = _long_runs(bad, pieces, _longest_unclear(strips.width))
    near = hidden.copy()
    for step in range(1, BESIDE_HIDDEN + 1):
        near |= (np.roll(hidden, step) & (pieces.before >= step)) | (np.roll(hidden, -step) & (pieces.after >= step))
    return ~near


def _long_runs(where: Bool[np.ndarray, "m"], pieces: Pieces, least: int) -> Bool[np.ndarray, "m"]:
    """Which places are in runs of at least so many on one piece."""
    begins = where & ((pieces.before == 0) | ~np.roll(where, 1))
    run = np.cumsum(begins)
    return where & (np.bincount(run[where], minlength=int(run[-1]) + 1)[run] >= least)


def _as_beside(bad: Bool[np.ndarray, "m"], counts: Bool[np.ndarray, "m"], pieces: Pieces) -> Bool[np.ndarray, "m"]:
    """What does not count is as the nearest place of its piece that does; on pieces without any, all counts."""
    where = np.flatnonzero(counts)
    if not len(where):
        return bad
    every = np.arange(len(bad))
    after = np.searchsorted(where, every).clip(0, len(where) - 1)
    of = np.stack((where[np.maximum(after - 1, 0)], where[after]))
    same = pieces.number[of] == pieces.number
    nearest = of[np.where(same, np.abs(of - every), len(bad)).argmin(axis=0), every]
    return np.where(same.any(axis=0), bad[nearest], bad)


def _counts(strips: _Strips) -> Bool[np.ndarray, "m"]:
    """Where profiles show the thread alone: not beside a cut, where they hold what crosses too."""
    pieces, near = strips.sampled, CUT_WIDTHS * strips.width / EVERY
    after_cut = (pieces.before < near) & ~strips.trail.loose_start[pieces.number]
    before_cut = (pieces.after < near) & ~strips.trail.loose_end[pieces.number]
    return ~(after_cut | before_cut)


def _stretches(seen: Bool[np.ndarray, "n"], strips: _Strips) -> _Stretches:
    """Those of the pieces that are long enough; where something hides a piece, the thread is loose beside it."""
    pieces, trail = strips.pieces, strips.trail
    first = np.flatnonzero(seen & ((pieces.before == 0) | ~np.roll(seen, 1)))
    last = np.flatnonzero(seen & ((pieces.after == 0) | ~np.roll(seen, -1)))
    long = STRIDE * (last - first) >= LEAST_LENGTH_PX
    first, last = first[long], last[long]
    piece = pieces.number[first]
    outermost = np.diff(piece, prepend=-1) != 0, np.diff(piece, append=-1) != 0
    return _Stretches(
        first,
        last,
        piece,
        trail.loose_start[piece] | (pieces.before[first] > 0),
        trail.loose_end[piece] | (pieces.after[last] > 0),
        trail.told_start[piece] & outermost[0],
        trail.told_end[piece] & outermost[1],
    )


def _with_ends(
    image: UInt8[np.ndarray, "h w 3"], eyes: Eyes, strips: _Strips, found: Captured, stretches: _Stretches
) -> tuple[Curves, Float64[np.ndarray, "n"], Bool[np.ndarray, "e"]]:
    """Stretches where they are now, out to where the thread ends, how wide they are, and which ends the image shows."""
    width, count = strips.width, stretches.last - stretches.first + 1
    kept = np.concatenate([np.arange(a, b + 1) for a, b in zip(stretches.first, stretches.last, strict=True)])
    pieces = Pieces(np.repeat(np.arange(len(count)), count))
    move = found.move_px[:, None] * strips.normal
    point = (strips.point + np.column_stack([strips.between(part) for part in move.T]))[kept]
    usual = strips.between(usual_width_px(strips.width_px[strips.some], strips.sampled, EVERY))[kept]
    tips, outward = _tips(pieces, _tangents(point, pieces, width))
    of_tip = np.searchsorted(strips.some, kept[tips]).clip(0, len(strips.some) - 1)
    ends = ends_of(image, point[tips], outward, width, strips.trail.colour_bgr[of_tip], eyes)
    told = np.concatenate((stretches.told_start, stretches.told_end))
    # thread that goes on as far as is looked is followed on from there in the next frame
    reach_px = np.where(told & (~ends.lost | (ends.reach_px > 0)), ends.reach_px, 0.0)
    place, now = with_ends(point, pieces, outward, reach_px)
    share = now.before / np.maximum(1, now.before + now.after)
    length = pieces.last - pieces.first
    usual = np.interp(pieces.first[now.number] + share * length[now.number], np.arange(len(kept)), usual)
    return Curves(place, now, stretches.loose_start, stretches.loose_end), usual, told & ~ends.lost


def _refined(
    image: UInt8[np.ndarray, "h w 3"],
    eyes: Eyes,
    curves: Curves,
    width_px: Float64[np.ndarray, "n"],
    width: float,
    told: Bool[np.ndarray, "e"],
) -> Centrelines | str:
    """The curves in the middle of the thread, out to the tips that the image shows."""
    nothing = np.zeros(len(width_px))
    mask = Evidence(width_px, nothing, nothing > 0)
    curves, seen = by_edges(curves, mask, image, width + 1.5)
    alike = (seen.width_px > LEAST_WIDTH * width_px) & (seen.width_px < MOST_WIDTH * width_px)
    if alike.mean() < WIDTH_SHARE:
        return f"{1 - alike.mean():.0%} of the thread is of another width"
    if (learned := by_learning(curves, seen, image, width + 1.5)) is None:
        at_sight = of_edges(curves, seen)
    else:
        curves, seen, at_sight = learned
    deviation = deviations(curves, seen, at_sight)
    lines = StackedLines(eyes.clipped(curves.point), curves.pieces.number, seen.width_px, deviation)
    return to_tips(lines, image, *np.split(told, 2))


def _tips(pieces: Pieces, tangent: Float64[np.ndarray, "n 2"]) -> tuple[Int64[np.ndarray, "e"], np.ndarray]:
    """The first points of all pieces and then their last ones, and the directions outwards."""
    tips = np.concatenate((pieces.first, pieces.last))
    return tips, np.concatenate((-tangent[pieces.first], tangent[pieces.last]))


def _tangents(point: Float64[np.ndarray, "m 2"], sampled: Pieces, width: float) -> Float64[np.ndarray, "m 2"]:
    return directions(point, sampled, gaussian(tangent_sigma(width) / EVERY))


def _colours(
    image: UInt8[np.ndarray, "h w 3"],
    point: Float64[np.ndarray, "m 2"],
    width_px: Float64[np.ndarray, "m"],
    sampled: Pieces,
    tangent: Float64[np.ndarray, "m 2"],
) -> Colours:
    return colours_across(image, point, normals(tangent), usual_width_px(width_px, sampled, EVERY), sampled)
