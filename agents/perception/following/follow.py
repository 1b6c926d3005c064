"""Centrelines of the frame before, found again in this one; or why they cannot be.

1. `capture` tells by how far each point has moved across the line.
2. `ends` tells where pieces end now.
3. The rounds by edges and by what is learned are those of every frame, so that nothing adds up from frame to frame.

A frame counts as followed only where nearly all profiles show a thread as wide and as clear as before, neighbours have
moved alike, and every end is found within reach. Whatever else happened needs a look at the pixels. Both eyes are
worked on at once, in one image that holds both (`stacked`), and each is judged by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.perception.centrelines.along import STRIDE, Pieces, directions, gaussian, median
from agents.perception.centrelines.deviation import deviations, of_edges
from agents.perception.centrelines.profiles import normals
from agents.perception.centrelines.refine import Curves, Evidence, by_edges, by_learning, tangent_sigma
from agents.perception.centrelines.straightened import usual_width_px
from agents.perception.centrelines.tips import to_tips
from agents.perception.following.appearance import EVERY, Colours, colours_across, pieces_of, some_of, some_of_observed
from agents.perception.following.capture import Captured, captured
from agents.perception.following.ends import REACH_PX, carried_along, ends_of, with_ends
from agents.perception.following.stacked import (
    Eyes,
    StackedLines,
    lines_of,
    stacked_images,
    stacked_lines,
    stacked_trails,
)
from schemas.messages import Centrelines, Trail

LEAST_CLEAR, CLEAR_SHARE = 0.25, 0.95
"""How much more of a profile is thread than of what lies beside it, and at how many of them at least."""
ASTRAY_SHARE = 0.08
LONGEST_UNCLEAR_WIDTHS = 3.0
"""Stretches that do not show the thread as it was are hidden, and no chance."""
LEAST_WIDTH, MOST_WIDTH, WIDTH_SHARE = 0.7, 1.4, 0.92
"""Of the width before, and at how many points at least it must be like that."""
LEAST_LENGTH_PX = 3
"""Of a piece: what is shorter has no direction of its own."""
OTHER_LENGTH_PX, OTHER_LENGTH_UNTOLD_PX, OTHER_LENGTH_SHARE = 6.0, 15.0, 0.005
"""A piece that has become so much longer or shorter than when it was looked for may have gone astray at its ends; one
with an end that the image does not show may have lost it by a little more."""
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
class _Found:
    """The centrelines of all eyes in the image that holds them, and their colours with the piece that shows each."""

    lines: Centrelines
    colours: Colours
    piece: Int64[np.ndarray, "m"]


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
    width, point, sampled = median(lines.width_px), lines.point_px[some], Pieces(pieces.number[some])
    tangent = _tangents(point, sampled, width)
    colours = _colours(image, point, lines.width_px[some], sampled, tangent)
    tips, outward = _tips(sampled, tangent)
    eye = Eyes(image.shape[0], image.shape[1], 1)
    ends = ends_of(image, point[tips], outward, width, colours[tips], eye)
    long = np.tile(lengths_px(pieces) >= 2 * REACH_PX, 2)
    told = np.concatenate((loose_start, loose_end)) & long & ~ends.lost & (np.abs(ends.reach_px) <= TOLD_PX)
    return Trail(loose_start, loose_end, lengths_px(pieces), colours, *np.split(told, 2))


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


def lengths_px(pieces: Pieces) -> Float64[np.ndarray, "k"]:
    """Of each piece, whose points lie a pixel apart."""
    return (pieces.last - pieces.first).astype(np.float64)


def follow(images: Sequence[UInt8[np.ndarray, "h w 3"]], last: Sequence[Followed]) -> tuple[Followed, ...] | str:
    """The centrelines in the next images of some eyes, all of one size; or why those of one were not found."""
    if any(len(eye.lines.piece) == 0 for eye in last):
        return "no pieces"
    image, eyes = stacked_images(images)
    before, eye = stacked_lines([each.lines for each in last], eyes)
    found = _follow(image, eyes, eye, before, stacked_trails([each.trail for each in last]))
    if isinstance(found, str):
        return found
    of_colour = eye[found.piece]
    return tuple(
        Followed(lines_of(found.lines, eye, k, eyes), replace(each.trail, colour_bgr=found.colours[of_colour == k]))
        for k, each in enumerate(last)
    )


def every_second(lines: Centrelines) -> Centrelines:
    """Every second point of centrelines: neighbours err alike, and the others say hardly more."""
    some, _ = pieces_of(lines).every_second
    return Centrelines(lines.point_px[some], lines.piece[some], lines.width_px[some], lines.deviation_px[some])


def _follow(
    image: UInt8[np.ndarray, "h w 3"], eyes: Eyes, eye: Int64[np.ndarray, "k"], before: StackedLines, trail: Trail
) -> _Found | str:
    """The same in an image that holds all eyes.

    Args:
        eye: of each piece.
        before: as observations send them (`every_second`).
    """
    pieces = Pieces(before.piece)
    if STRIDE * int((pieces.last - pieces.first).min()) < LEAST_LENGTH_PX:
        return "short pieces"
    some, width = some_of_observed(pieces), median(before.width_px)
    if len(some) != len(trail.colour_bgr):
        return "points as older versions sent them"
    point, sampled = before.point_px[some], Pieces(pieces.number[some])
    normal = normals(_tangents(point, sampled, width))
    found = captured(image, point, normal, width, trail.colour_bgr, sampled)
    counts, of_eye = _counts(pieces, trail, width)[some], eye[sampled.number]
    for k in range(eyes.count):
        if reason := _unclear(found, counts, of_eye == k, width):
            return reason
    move = found.move_px[:, None] * normal
    there = point + move
    tips, outward = _tips(sampled, _tangents(there, sampled, width))
    ends = ends_of(image, there[tips], outward, width, trail.colour_bgr[tips], eyes)
    told = np.concatenate((trail.told_start, trail.told_end))
    if (ends.lost & told).any():
        return f"{int((ends.lost & told).sum())} ends out of reach"
    reach_px = ends.reach_px
    if not told.all():
        reach_px = np.where(told, reach_px, carried_along(there[tips], outward, point, normal, found.move_px))
    every = np.arange(len(before.point_px))
    moved = before.point_px + np.column_stack([np.interp(every, some, along) for along in move.T])
    place, now = with_ends(moved, pieces, outward, reach_px)
    if _has_another_length(now, trail):
        return "a piece has another length"
    curves = Curves(place, now, trail.loose_start, trail.loose_end)
    usual = _carried(usual_width_px(before.width_px[some], sampled, EVERY), some, pieces, now)
    return _refined(image, eyes, eye, curves, usual, width, trail)


def _has_another_length(pieces: Pieces, trail: Trail) -> bool:
    """Whether a piece has become longer or shorter than threads do within a second."""
    both_told = trail.told_start & trail.told_end
    most = np.where(both_told, OTHER_LENGTH_PX, OTHER_LENGTH_UNTOLD_PX) + OTHER_LENGTH_SHARE * trail.length_px
    return bool((np.abs(lengths_px(pieces) - trail.length_px) > most).any())


def _counts(pieces: Pieces, trail: Trail, width: float) -> Bool[np.ndarray, "n"]:
    """Where profiles show the thread alone: not beside a cut, where they hold what crosses too, nor on short pieces."""
    near = CUT_WIDTHS * width / STRIDE
    beside = ((pieces.before < near) & ~trail.loose_start[pieces.number]) | (
        (pieces.after < near) & ~trail.loose_end[pieces.number]
    )
    return ~beside & (STRIDE * (pieces.before + pieces.after) >= 2 * REACH_PX)


def _unclear(found: Captured, counts: Bool[np.ndarray, "m"], here: Bool[np.ndarray, "m"], width: float) -> str:
    """Why what was found in one eye is not the thread as it was; empty where it is.

    Args:
        here: which points lie in that eye.
    """
    counts = counts[here]
    unclear, astray = (found.clear[here] < LEAST_CLEAR) & counts, found.astray[here] & counts
    total = max(1, int(counts.sum()))
    if unclear.sum() > (1 - CLEAR_SHARE) * total:
        return "the thread is not clear"
    if astray.sum() > ASTRAY_SHARE * total:
        return "neighbours move otherwise"
    longest = max(2, round(LONGEST_UNCLEAR_WIDTHS * width / 4))
    bad = (unclear | astray).astype(np.int64)
    run = np.convolve(bad, np.ones(longest, np.int64), "valid")
    return "a stretch is hidden" if (run == longest).any() else ""


def _carried(
    values: Float64[np.ndarray, "m"], some: Int64[np.ndarray, "m"], pieces: Pieces, now: Pieces
) -> Float64[np.ndarray, "n"]:
    """Values at some points of pieces at the places of pieces that are a little longer or shorter."""
    length = pieces.last - pieces.first
    share = now.before / np.maximum(1, now.before + now.after)
    return np.interp(pieces.first[now.number] + share * length[now.number], some, values)


def _refined(
    image: UInt8[np.ndarray, "h w 3"],
    eyes: Eyes,
    eye: Int64[np.ndarray, "k"],
    curves: Curves,
    width_px: Float64[np.ndarray, "n"],
    width: float,
    trail: Trail,
) -> _Found | str:
    nothing = np.zeros(len(width_px))
    mask = Evidence(width_px, nothing, nothing > 0)
    curves, seen = by_edges(curves, mask, image, width + 1.5)
    alike = (seen.width_px > LEAST_WIDTH * width_px) & (seen.width_px < MOST_WIDTH * width_px)
    of_eye = eye[curves.pieces.number]
    share = np.bincount(of_eye, alike) / np.maximum(np.bincount(of_eye), 1)
    if share.min() < WIDTH_SHARE:
        return f"{1 - share.min():.2f} of other width"
    if (learned := by_learning(curves, seen, image, width + 1.5)) is None:
        at_sight = of_edges(curves, seen)
    else:
        curves, seen, at_sight = learned
    deviation = deviations(curves, seen, at_sight)
    lines = StackedLines(eyes.clipped(curves.point), curves.pieces.number, seen.width_px, deviation)
    lines = to_tips(lines, image, trail.told_start, trail.told_end)
    some = some_of(Pieces(lines.piece))
    point, sampled = lines.point_px[some], Pieces(lines.piece[some])
    colours = _colours(image, point, lines.width_px[some], sampled, _tangents(point, sampled, width))
    return _Found(lines, colours, sampled.number)
