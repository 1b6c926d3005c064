"""Ends of one eye's lines that lie short of where the other eye sees the thread end.

A segmenter may stop short in one eye, where the ground changes beneath the thread, and go on in the other one. Along
the rows the ends alone tell depth, so that a few pixels are millimetres. From places that both eyes see the disparity
goes on to the end of a line. Where the other eye's line runs on from there, this one goes on too, as far as its own
image shows thread.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, UInt8

from agents.perception.both_eyes.same_places import between, numbered, same_places
from agents.perception.centrelines.along import Pieces
from agents.perception.centrelines.centrelines import Lines
from agents.perception.centrelines.tips import gone_on
from schemas.messages import Centrelines
from shared.disparities import disparities

NEAR_PX = 40.0
"""So near to an end, along its line, a place must be that both eyes see."""
BESIDE_PX = 3.0
"""So far from where it is to be the other line may lie."""
SHORT_PX, DISPARITY_PX = 6.0, 6.0
"""An end is short where the other line runs on by more; and by how much more the line may go on than the other does."""
DIRECTION = 8
"""Points before an end that tell its direction."""


@dataclass(frozen=True)
class _Seen:
    """One eye's line, and what both eyes see of it.

    Fields:
        at: where along the points the same places are.
        from_other_px: columns from the other eye's place to this one's.
    """

    point_px: Float64[np.ndarray, "m 2"]
    pieces: Pieces
    at: Float64[np.ndarray, "n"]
    from_other_px: Float64[np.ndarray, "n"]


def ended_together(
    images: tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]],
    left: Lines,
    right: Lines,
    shown_px: Float64[np.ndarray, "2"] | None = None,
) -> tuple[Centrelines, Centrelines]:
    """Both eyes' centrelines, with ends that go on where the other eye sees more of the thread.

    Args:
        images: BGR, rectified, their rows in line.
        shown_px: least and greatest disparity of thread, as far as the pair shows them.
    """
    lines = left.centrelines, right.centrelines
    places = same_places(*lines, disparities(images[0].shape[1], shown_px))
    if places is None:
        return lines
    disparity = (lines[0].point_px[places.left_at] - between(lines[1].point_px, places.right_at))[:, 0]
    of_left, of_right = (
        _Seen(line.point_px, Pieces(numbered(line.piece)), at, from_other)
        for line, at, from_other in zip(
            lines, (places.left_at.astype(np.float64), places.right_at), (disparity, -disparity), strict=True
        )
    )
    return (
        _ended(images[0], left, _short_px(left, of_left, of_right)),
        _ended(images[1], right, _short_px(right, of_right, of_left)),
    )


def _ended(image: UInt8[np.ndarray, "h w 3"], found: Lines, short_px: Float64[np.ndarray, "2 k"]) -> Centrelines:
    lines = found.centrelines
    if not short_px.any():
        return lines
    return gone_on(replace(lines, piece=numbered(lines.piece)), image, short_px[0], short_px[1])


def _short_px(found: Lines, own: _Seen, other: _Seen) -> Float64[np.ndarray, "2 k"]:
    """How far each piece may go on before its first and beyond its last point; 0 where the other eye's ends as well."""
    pieces, of_place = own.pieces, own.pieces.number[np.rint(own.at).astype(np.int64)]
    short = np.zeros((2, len(pieces.first)))
    may_be = np.isin(np.arange(len(pieces.first)), of_place) & (pieces.last - pieces.first > DIRECTION)
    sides = (pieces.first, found.loose_start, DIRECTION), (pieces.last, found.loose_end, -DIRECTION)
    for side, (ends, loose, inwards) in enumerate(sides):
        for piece in np.flatnonzero(loose & may_be).tolist():
            end = int(ends[piece])
            away = np.where(of_place == piece, np.abs(own.at - end), np.inf)
            place = int(np.argmin(away))
            seen = own.point_px[end] - (own.from_other_px[place], 0.0)
            outward = own.point_px[end] - own.point_px[end + inwards]
            more = _runs_on_px(seen, outward, other, int(other.at[place])) if away[place] <= NEAR_PX else 0.0
            short[side, piece] = more + DISPARITY_PX if more > SHORT_PX else 0.0
    return short


def _runs_on_px(
    seen_px: Float64[np.ndarray, "2"], outward: Float64[np.ndarray, "2"], other: _Seen, beside: int
) -> float:
    """How far the other line, with points a pixel apart, runs on in a direction from a place; 0 if it is not there.

    Args:
        beside: a point of the piece that is meant.
    """
    number = other.pieces.number[beside]
    first, last = int(other.pieces.first[number]), int(other.pieces.last[number])
    off = np.linalg.norm(other.point_px[first : last + 1] - seen_px, axis=1)
    nearest = first + int(np.argmin(off))
    if off[nearest - first] > BESIDE_PX:
        return 0.0
    way = other.point_px[min(nearest + 1, last)] - other.point_px[max(nearest - 1, first)]
    return float(last - nearest if way @ outward > 0 else nearest - first)
