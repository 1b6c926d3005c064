"""Whether a line lies in the ground, as print does, or stands off it, as thread does.

A line's relief is by how many pixels its disparity is larger than that of the ground behind it. A thread of w px across
that lies on the ground has its middle b w / z before it: thread of 0.3 mm at 80 mm, seen 5 mm apart, 0.2 px. Most
threads stand off farther in places; print has no relief at all. So a line lies in the ground if its relief is less than
a thread's own would be, by more than some deviations: two, or fewer where the segmenter itself is not sure of it.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from agents.perception.candidates.patches import before_planes, ground_planes, looked_up, patches_around
from schemas.messages import Centrelines

MOST_PLACES, LEAST_PLACES = 24, 5
"""Along a line; neighbouring ones tell much the same."""
ALONG_ROWS = 0.35
"""The sine of the smallest angle to the rows at which a row crosses a line in one place."""
PARALLEL = 0.95
"""The cosine of the largest angle between the line in both eyes."""
BESIDE_SHARE = 1 / 240
"""Of the image's width: so near to a line nothing counts as ground."""
LYING = 0.8
"""Of a thread's own relief, at least: its sides lie behind its middle."""
COMMON_PX = 0.1
"""Deviation of what errs alike all along: the shadow beside a thread on the ground draws it there by 0.2 px."""
APART = 2.0
"""So many neighbouring places see the same, and count as one."""
CERTAIN = 2.0
"""Deviations: true threads that lie on paper come to 1.6."""
FOR_EACH = 4
"""Places that are tried for each: not all are seen by both eyes, and once."""
FIRST_EVERY = 2
"""Of the places are asked first, and the others only where it may come of it that the line lies in the ground."""

Image = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class Relief:
    """How far a line stands off the ground, at places along it.

    Fields:
        own_px: what the relief of a thread of this width would be if it lay on the ground.
        relief_px: NaN where line or ground do not tell.
        deviations: by how many less than its own the relief must be.
    """

    own_px: float
    relief_px: Float64[np.ndarray, "n"]
    deviations: float = CERTAIN

    @property
    def is_none(self) -> bool:
        """Whether the line certainly lies in the ground."""
        return self._is_none_with(int(np.isfinite(self.relief_px).sum()))

    @property
    def may_be_none(self) -> bool:
        """Whether that could be certain, if more places were asked that say much the same."""
        return np.isfinite(self.relief_px).sum() < LEAST_PLACES or self._is_none_with(MOST_PLACES)

    def _is_none_with(self, places: int) -> bool:
        told = self.relief_px[np.isfinite(self.relief_px)]
        if len(told) < LEAST_PLACES:
            return False
        deviation = COMMON_PX + float(told.std(ddof=1)) / np.sqrt(places / APART)
        return bool(told.mean() + self.deviations * deviation < LYING * self.own_px)


def relief_of(
    images: tuple[Image, Image],
    lines: tuple[Centrelines, Centrelines],
    line: tuple[Centrelines, Centrelines],
    focal_px: float,
    deviations: float = CERTAIN,
) -> Relief:
    """The relief of a line that both eyes see.

    Args:
        images: rectified.
        lines: the middle of all that was segmented, left and right: none of it is ground.
        line: that which is asked about, left and right.
        focal_px: of the rectified camera.
        deviations: by how many less than its own the relief of a line is that lies in the ground.
    """
    at, disparity = _crossings(*line)
    if len(at) == 0:
        return Relief(0.0, disparity, deviations)
    some = replace(
        _relief_at(at[::FIRST_EVERY], disparity[::FIRST_EVERY], images, lines, line[0], focal_px), deviations=deviations
    )
    if not some.may_be_none:
        return some
    return replace(_relief_at(at, disparity, images, lines, line[0], focal_px), deviations=deviations)


def _relief_at(
    at: Float64[np.ndarray, "n 2"],
    disparity: Float64[np.ndarray, "n"],
    images: tuple[Image, Image],
    lines: tuple[Centrelines, Centrelines],
    line: Centrelines,
    focal_px: float,
) -> Relief:
    """The relief of the left image's line at these places."""
    shape = images[0].shape
    patches = patches_around(images, at)
    beside_px = 2.0 * BESIDE_SHARE * shape[1]
    left, right = (_within(_drawn(all_of_it, beside_px, shape)) for all_of_it in lines)
    plane, told = ground_planes(patches, (left, right), disparity)
    of_line = looked_up(_drawn(line, 0.0, shape), patches.u, patches.v)[..., 0] > 127
    relief = before_planes(patches, plane, of_line, disparity - plane[:, 0])
    own = float(np.median(line.width_px) * np.median(disparity)) / focal_px
    return Relief(own, np.where(told, relief, np.nan))


def _crossings(left: Centrelines, right: Centrelines) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n"]]:
    """Points of the left line that lie in the row of one place of the right line, and their disparities."""
    if len(left.piece) == 0 or len(right.piece) < 2:
        return np.zeros((0, 2)), np.zeros(0)
    along_left, along_right = _directions(left), _directions(right)
    steep = np.flatnonzero(np.abs(along_left[:, 1]) >= ALONG_ROWS)
    at = _some(steep, FOR_EACH * MOST_PLACES)
    u, v = left.point_px[at].T
    first, second = right.point_px[:-1], right.point_px[1:]
    crosses = (np.diff(right.piece) == 0) & ((first[:, 1] <= v[:, None]) != (second[:, 1] <= v[:, None]))
    crosses &= np.abs(along_left[at] @ along_right[:-1].T) >= PARALLEL
    once = _some(np.flatnonzero(crosses.sum(axis=1) == 1), MOST_PLACES)
    segment = np.argmax(crosses[once], axis=1) if len(once) else once
    (u0, v0), (u1, v1) = first[segment].T, second[segment].T
    disparity = u[once] - (u0 + (v[once] - v0) / (v1 - v0) * (u1 - u0))
    before = disparity > 0
    return left.point_px[at[once[before]]], disparity[before]


def _some(every: Int64[np.ndarray, "n"], most: int) -> Int64[np.ndarray, "k"]:
    """At most so many of them, evenly spread."""
    return every[np.unique(np.linspace(0, len(every) - 1, most).astype(np.intp))] if len(every) else every


def _directions(lines: Centrelines) -> Float64[np.ndarray, "n 2"]:
    """Unit vectors along the line; none at the ends of its pieces."""
    run = np.zeros_like(lines.point_px)
    run[1:-1] = lines.point_px[2:] - lines.point_px[:-2]
    run[1:-1][lines.piece[2:] != lines.piece[:-2]] = 0.0
    return run / np.maximum(np.linalg.norm(run, axis=1, keepdims=True), 1e-9)


def _drawn(lines: Centrelines, beside_px: float, shape: tuple[int, ...]) -> UInt8[np.ndarray, "h w 1"]:
    """255 along the lines, as wide as they are and so much wider."""
    drawn = np.zeros((*shape[:2], 1), np.uint8)
    wide = beside_px + (float(np.median(lines.width_px)) if len(lines.piece) else 0.0)
    pieces = np.split(np.rint(lines.point_px).astype(np.int32), np.flatnonzero(np.diff(lines.piece)) + 1)
    cv2.polylines(drawn, [piece[:, None] for piece in pieces], False, 255, max(1, round(wide)))
    return drawn


def _within(drawn: UInt8[np.ndarray, "h w 1"]) -> UInt8[np.ndarray, "h w 1"]:
    """The same with the image's border, beyond which nothing is known."""
    cv2.rectangle(drawn, (0, 0), (drawn.shape[1] - 1, drawn.shape[0] - 1), 255)
    return drawn
