"""Images of several eyes as one, one above the other.

What is done along points of a thread takes NumPy about as long for one eye as for two, since single operations take
microseconds. So the points of both eyes are worked on at once, in one image that holds both.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.perception.following.appearance import pieces_of, some_of
from schemas.messages import Centrelines, Trail

BETWEEN_PX = 64
"""Rows between two eyes, the nearest eye's border over and over: as far as anything looks beyond an image's border."""


@dataclass(frozen=True)
class Eyes:
    """Where in a stacked image each of its eyes lies, all of one size."""

    height: int
    width: int
    count: int

    @property
    def pitch(self) -> int:
        """Rows from an eye's first to the next one's."""
        return self.height + BETWEEN_PX

    def top(self, point: Float64[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n"]:
        """The first row of the eye that each place belongs to."""
        eye = np.floor((point[..., 1] + BETWEEN_PX / 2) / self.pitch)
        return eye.clip(0, self.count - 1) * self.pitch

    def within(self, point: Float64[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether each place lies in an eye's image."""
        u, v = point[..., 0], point[..., 1] - self.top(point)
        return (u >= 0) & (u <= self.width - 1) & (v >= 0) & (v <= self.height - 1)

    def clipped(self, point: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Places that lie in their eye's image."""
        top = self.top(point)
        return np.column_stack((point[:, 0].clip(0, self.width - 1), point[:, 1].clip(top, top + self.height - 1)))


class StackedLines(Centrelines):
    """All eyes' centrelines in the stacked image: no message, and so not checked each time that some are made."""

    def __post_init__(self) -> None:
        """Nothing: a message is made of them in the end, and that is checked."""


def stacked_images(images: Sequence[UInt8[np.ndarray, "h w 3"]]) -> tuple[UInt8[np.ndarray, "k w 3"], Eyes]:
    """Images of one size, one above the other, with rows between them; and where they lie."""
    height, width = images[0].shape[:2]
    eyes = Eyes(height, width, len(images))
    stack = np.empty((len(images) * eyes.pitch - BETWEEN_PX, width, 3), np.uint8)
    for k, image in enumerate(images):
        top = k * eyes.pitch
        stack[max(0, top - BETWEEN_PX // 2) : top] = image[0]
        stack[top : top + height] = image
        stack[top + height : top + height + BETWEEN_PX // 2] = image[-1]
    return stack, eyes


def stacked_lines(lines: Sequence[Centrelines], eyes: Eyes) -> tuple[StackedLines, Int64[np.ndarray, "k"]]:
    """All eyes' centrelines in the stacked image, their pieces numbered without gaps; and the eye of each piece."""
    pieces = [pieces_of(line).number for line in lines]
    counts = [int(piece[-1]) + 1 if len(piece) else 0 for piece in pieces]
    first = np.cumsum((0, *counts))
    whole = StackedLines(
        np.concatenate([line.point_px + np.array((0, k * eyes.pitch)) for k, line in enumerate(lines)]),
        np.concatenate([piece + start for piece, start in zip(pieces, first, strict=False)]),
        np.concatenate([line.width_px for line in lines]),
        np.concatenate([line.deviation_px for line in lines]),
    )
    return whole, np.repeat(np.arange(len(lines)), counts)


def lines_of(whole: Centrelines, eye: Int64[np.ndarray, "k"], which: int, eyes: Eyes) -> Centrelines:
    """One eye's centrelines, in its own image."""
    pieces = np.searchsorted(eye, (which, which + 1))
    mine = slice(*np.searchsorted(whole.piece, pieces))
    return Centrelines(
        whole.point_px[mine] - np.array((0, which * eyes.pitch)),
        whole.piece[mine] - pieces[0],
        whole.width_px[mine],
        whole.deviation_px[mine],
    )


def stacked_trails(trails: Sequence[Trail]) -> Trail:
    """All eyes' trails as one, piece after piece."""
    starts, ends, lengths, colours, told_starts, told_ends = (
        np.concatenate(parts)
        for parts in zip(
            *((t.loose_start, t.loose_end, t.length_px, t.colour_bgr, t.told_start, t.told_end) for t in trails),
            strict=True,
        )
    )
    return Trail(starts, ends, lengths, colours, told_starts, told_ends)


def side_by_side(lines: Sequence[Centrelines], trails: Sequence[Trail]) -> tuple[Centrelines, Trail]:
    """Several threads of one eye as one, piece after piece."""
    if len(lines) == 1:
        return lines[0], trails[0]
    pieces = [pieces_of(line).number for line in lines]
    counts = [int(piece[-1]) + 1 if len(piece) else 0 for piece in pieces]
    first = np.cumsum((0, *counts))
    whole = Centrelines(
        np.concatenate([line.point_px for line in lines]),
        np.concatenate([piece + start for piece, start in zip(pieces, first, strict=False)]),
        np.concatenate([line.width_px for line in lines]),
        np.concatenate([line.deviation_px for line in lines]),
    )
    return whole, stacked_trails(trails)


def trail_of_eye(whole: Trail, piece: Bool[np.ndarray, "k"], sampled: Bool[np.ndarray, "m"]) -> Trail:
    """Of a trail of all eyes, that of some pieces and of the points at which their colours are known."""
    return Trail(
        whole.loose_start[piece],
        whole.loose_end[piece],
        whole.length_px[piece],
        whole.colour_bgr[sampled],
        whole.told_start[piece],
        whole.told_end[piece],
    )


def trail_without(trail: Trail | None, lines: Centrelines, kept: Centrelines) -> Trail | None:
    """The trail of centrelines of which some pieces were left out.

    Args:
        lines: those that the trail is of.
        kept: what is left of them, its pieces numbered anew.
    """
    if trail is None or kept is lines:
        return trail
    pieces = pieces_of(lines)
    first, first_kept = lines.point_px[pieces.first], kept.point_px[pieces_of(kept).first]
    mine = (first[:, None] == first_kept).all(axis=2).any(axis=1)
    return trail_of_eye(trail, mine, mine[pieces.number[some_of(pieces)]])
