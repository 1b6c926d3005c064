"""What something that lies before a thread does to it: to its middle beside the cover, and to what is seen of it.

Where something covers one side of a thread, its middle is not in the middle of what is seen.

A cover that hides m pixels of a thread's width moves the middle of the rest by m / 2 to the other side. That happens
at the ends of pieces, where the thread goes under a tool or under its own strand at a small angle, and there it looks
narrower than a little farther in. A thread's own tip is narrower too, but on both sides: its middle stays on the way
that the thread has come. So the error is half of what is missing, times how far the middle follows that to one side.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from schemas.messages import Centrelines, Image, Occluders
from shared.images import ImageDataError, decode_image
from shared.occluded import hidden_ends, is_occluded

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
