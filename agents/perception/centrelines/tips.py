"""Where a thread ends in the image, along its own direction, to less than a pixel.

A mask ends a pixel or two too soon or too late, and otherwise in the other image; where a thread ends along the rows,
its tip alone tells its depth there. So along the direction of each loose end the image is taken for a mixture of the
thread's colour, further inwards, and the ground's, beside the end: the tip lies where the thread's share falls to a
half.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.perception.centrelines.along import Pieces
from agents.perception.centrelines.profiles import seen_around
from schemas.messages import Centrelines

STEP_PX = 0.25
WITHIN_WIDTHS = np.linspace(-0.25, 0.25, 5)
"""To either side of the middle, where nothing but thread is seen."""
BESIDE_PX = np.array([2.0, 3.0, 4.0])
"""Beyond the thread's edges: nothing but ground."""
DIRECTION_WIDTHS, BODY_WIDTHS = 2.0, 2.0
"""How much of the end its direction is taken of; and how far within the thread its colour is, for so many widths."""
REACH_PX = 4.0
"""How far beyond a width a tip is looked for."""
MOST_TAKEN_WIDTHS, MOST_TAKEN_PX = 0.8, 3.0
"""A mask hardly shows more than so many widths, or at least so many pixels, that are no thread."""
LEAST_SPACING_PX = 0.3
SMOOTHED_PX = 1.25
AFTER_PX, LEFT_AFTER = 3.0, 0.4
"""For so far after the tip the thread's share must be as small as that on average: else it goes on, or is hidden."""
LEAST_CONTRAST, LEAST_OF_GROUND = 25.0, 3.0
"""Between thread and ground, in grey levels and in what the ground differs from itself."""


def to_tips(
    lines: Centrelines,
    image: UInt8[np.ndarray, "h w 3"],
    loose_start: Bool[np.ndarray, "k"],
    loose_end: Bool[np.ndarray, "k"],
) -> Centrelines:
    """Centrelines that end where the image shows the thread's tips; where it does not, they end as they did.

    Args:
        loose_start, loose_end: of each piece, whether its first and last point is an end of the thread, no cut.
    """
    ends = _loose_ends(lines, loose_start, loose_end)
    return lines if ends is None else _ended(lines, ends, _shifts(lines, image, ends))


@dataclass(frozen=True)
class _Ends:
    """Loose ends.

    Fields:
        pieces: of all lines.
        at: the index of each end among the points; inwards: the step to the next one.
        width: of the thread there; outward: unit vectors.
    """

    pieces: Pieces
    at: Int64[np.ndarray, "e"]
    inwards: Int64[np.ndarray, "e"]
    width: Float64[np.ndarray, "e"]
    outward: Float64[np.ndarray, "e 2"]

    @property
    def piece(self) -> Int64[np.ndarray, "e"]:
        """The piece that each ends."""
        return self.pieces.number[self.at]


def _loose_ends(
    lines: Centrelines, loose_start: Bool[np.ndarray, "k"], loose_end: Bool[np.ndarray, "k"]
) -> _Ends | None:
    """The loose ends of pieces that are long enough to have a direction; None where there are none."""
    pieces = Pieces(lines.piece)
    first, last = pieces.first, pieces.last
    long = last - first >= 3
    ends = np.concatenate((first[loose_start & long], last[loose_end & long]))
    inwards = np.concatenate((np.ones((loose_start & long).sum(), int), -np.ones((loose_end & long).sum(), int)))
    if len(ends) == 0:
        return None
    piece = pieces.number[ends]
    length = (pieces.last - pieces.first)[piece]
    widths = {p: np.median(lines.width_px[first[p] : last[p] + 1]) for p in set(piece.tolist())}
    width = np.array([widths[p] for p in piece.tolist()])
    # the slope of a line through the end, by which no single point decides
    steps = np.arange(round(DIRECTION_WIDTHS * float(width.max())) + 3)
    near = lines.point_px[ends[:, None] + inwards[:, None] * np.minimum(steps, length[:, None])]
    tilt = np.linspace(1.0, -1.0, len(steps))
    outward = ((near - near.mean(axis=1, keepdims=True)) * tilt[:, None]).sum(axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    return _Ends(pieces, ends, inwards, width, outward)


def _shifts(lines: Centrelines, image: UInt8[np.ndarray, "h w 3"], loose: _Ends) -> Float64[np.ndarray, "e"]:
    """How far outwards from each end its tip lies, 0 where it is not seen."""
    ends, outward, width = loose.at, loose.outward, loose.width
    wide = float(width.max())
    reach = wide + REACH_PX
    along = np.arange(-reach - BODY_WIDTHS * wide, reach, STEP_PX)
    point = lines.point_px[ends]
    seen = seen_around(image, point, outward, along[None], width[:, None] * WITHIN_WIDTHS)
    beside = 0.5 * width[:, None] + BESIDE_PX
    places = np.arange(-wide, reach + wide, 1.0)
    sides = seen_around(image, point, outward, places[None], np.hstack((beside, -beside)))
    sides = sides.reshape(len(ends), -1, 3)
    ground = np.median(sides, axis=1)
    spread = np.linalg.norm(np.median(np.abs(sides - ground[:, None]), axis=1), axis=1)
    body = np.median(seen[:, along < -reach].reshape(len(ends), -1, 3), axis=1)
    contrast = np.linalg.norm(body - ground, axis=1)
    share = ((seen.mean(axis=2) - ground[:, None]) * (body - ground)[:, None]).sum(axis=2)
    share /= np.maximum(contrast, 1e-9)[:, None] ** 2
    told = (contrast >= LEAST_CONTRAST) & (contrast >= LEAST_OF_GROUND * spread)
    inner = along >= -reach
    found = _falls(_averaged(share)[:, inner], along[inner])
    limit = np.maximum(MOST_TAKEN_PX, MOST_TAKEN_WIDTHS * width)
    return np.where(told & np.isfinite(found) & (found >= -limit), found, 0.0)


def _averaged(share: Float64[np.ndarray, "e a"]) -> Float64[np.ndarray, "e a"]:
    side = round(SMOOTHED_PX / STEP_PX)
    return np.asarray(cv2.blur(share, (side, 1), borderType=cv2.BORDER_REPLICATE), np.float64)


def _falls(share: Float64[np.ndarray, "e a"], along: Float64[np.ndarray, "a"]) -> Float64[np.ndarray, "e"]:
    """Where each share first falls to a half and then stays low; infinite where it does not."""
    below = share < 0.5
    k = np.argmax(below, axis=1)
    here = np.arange(len(share))
    inside, outside = share[here, np.maximum(k - 1, 0)], share[here, k]
    at = along[np.maximum(k - 1, 0)] + STEP_PX * (inside - 0.5) / np.maximum(inside - outside, 1e-9)
    after = k[:, None] + np.arange(round(AFTER_PX / STEP_PX))
    low = share[here[:, None], np.minimum(after, share.shape[1] - 1)].mean(axis=1) <= LEFT_AFTER
    return np.where(low & (k > 0), at, np.inf)


def _ended(lines: Centrelines, loose: _Ends, shift: Float64[np.ndarray, "e"]) -> Centrelines:
    """The centrelines with points taken from their ends, or added to them in their direction, a pixel apart."""
    pieces, ends, inwards, outward = loose.pieces, loose.at, loose.inwards, loose.outward
    kept = np.ones(len(pieces.number), bool)
    taken = np.where(shift < 0, np.ceil(LEAST_SPACING_PX - shift), 0).astype(np.int64)
    # a piece keeps two points at the least
    shift = np.where(taken <= (pieces.last - pieces.first)[pieces.number[ends]] // 2 - 1, shift, 0.0)
    added: list[np.ndarray] = []
    for end, step, count, by in zip(ends.tolist(), inwards.tolist(), taken.tolist(), shift.tolist(), strict=True):
        kept[[end + step * k for k in range(count if by else 0)]] = False
        added.append(np.append(np.arange(1.0, by - LEAST_SPACING_PX), by) if by else np.zeros(0))
    of, by_px = np.repeat(np.arange(len(ends)), [len(steps) for steps in added]), np.concatenate(added)
    # in order along each piece: before its first point or after its last one
    place = ends[of] - inwards[of] * (0.25 + 0.001 * by_px)
    standing = np.flatnonzero(kept)
    order = np.argsort(np.concatenate((standing, place)), kind="stable")
    source = np.concatenate((standing, ends[of]))[order]
    # straight on beyond the end, back along the piece before it
    back, share = np.divmod(np.maximum(-by_px, 0.0), 1.0)
    inner = ends[of] + inwards[of] * back.astype(np.int64)
    way = lines.point_px[inner] + share[:, None] * (lines.point_px[inner + inwards[of]] - lines.point_px[inner])
    added_px = way + np.maximum(by_px, 0.0)[:, None] * outward[of]
    point_px, new = lines.point_px[source], np.flatnonzero(order >= len(standing))
    point_px[new] = added_px[order[new] - len(standing)]
    return type(lines)(point_px, lines.piece[source], lines.width_px[source], lines.deviation_px[source])
