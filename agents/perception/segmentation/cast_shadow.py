"""Segmented pixels that are no thread but the shadow that it casts beside itself, told by their colour.

A shadow is ground in less light: its colour is the ground's times a factor, however dark it is. A thread has a colour
of its own. So each segmented pixel is asked whether it lies nearer to the line through black of what the ground beside
the mask has, or to that of what the thread has. Where both are alike, as black thread and grey ground are, or where it
is too dark to tell, everything stays.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, UInt8
from scipy.spatial import cKDTree

SMALL = 4
"""By how much the image is reduced in which the ground's colour is seen."""
BESIDE_MASK, AVERAGED = 5, 9
"""Sides, in pixels of that image: nothing so near to the mask is ground; over so much of it the ground is averaged."""
AROUND = 3 * np.array(((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)))
"""Of that image: a shadow beside an edge of the ground lies on either side of it."""
FIRST_EVERY, LEAST_SHARE = 8, 0.03
"""Of the segmented pixels are asked first, and all of them where so many of these are shadow."""
APART = 2.0
"""Grey levels by which a colour lies nearer to the one line than to the other, where that is told."""
OF_GROUND, BRIGHTEST = 6.0, 1.1
"""How far from the ground's line a shadow may lie, and how bright it may be; brighter are glints."""
LEAST_COLOUR = 7.0
"""How far thread lies from the ground's line, where the one is told from the other."""
LEAST_PIXELS = 25
CALM = 5
"""Side of the window over whose segmented pixels the answers are averaged."""
REACH_SHARE = 0.04
"""Of the image's width: so far beside the thread its shadow lies."""
BESIDE_SHARE = 0.6
"""Of a shadow: so much of it has thread beside it rather than before or behind it, as a dull stretch of thread has."""
THICKER, AWAY = 1.4, 0.75
"""Than a strand the mask is at a shadow that touches it; one that does not lies so many widths away. What is neither
may be the thread's own side."""
TOLD_SHARE = 0.5
"""Of what is no shadow: so much must be known to be thread, so that thread and ground are told apart at all."""
CLOSE = 2.0
"""Widths from what is known to be thread, within which ground about a shadow lies."""
SPECK = 8
"""Pixels of which a region has no direction."""
MARGIN_PX = 48
"""Around the mask: so far the ground is looked at."""

Image = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class _Seen:
    """What some pixels show.

    Fields:
        colour: averaged over their neighbours.
        off_ground: how far that lies from the line of the ground's colour.
        brightness: in units of the ground's.
    """

    colour: Float32[np.ndarray, "n 3"]
    off_ground: Float32[np.ndarray, "n"]
    brightness: Float32[np.ndarray, "n"]


def without_cast_shadow(image: Image, thread: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The pixels that are thread, without regions beside it that are its shadow.

    Args:
        thread: what was segmented.
    """
    left, top, columns, rows = cv2.boundingRect(thread.view(np.uint8))
    if columns == 0:
        return thread
    box = np.s_[max(0, top - MARGIN_PX) : top + rows + MARGIN_PX, max(0, left - MARGIN_PX) : left + columns + MARGIN_PX]
    gone = _shadow_in(image[box], np.ascontiguousarray(thread[box]), REACH_SHARE * image.shape[1])
    if gone is None:
        return thread
    without = thread.copy()
    without[box] &= ~gone
    return without


def _shadow_in(image: Image, thread: Bool[np.ndarray, "h w"], reach_px: float) -> Bool[np.ndarray, "h w"] | None:
    """What of the segmented pixels is shadow; None where nothing is."""
    pixel = np.flatnonzero(thread)
    some = pixel[::FIRST_EVERY]
    if len(some) < LEAST_PIXELS:
        return None
    soft, ground = cv2.blur(image, (3, 3)), _ground(image, thread)
    first = _seen(soft, ground, some)
    own = _colour_of_thread(first)
    if own is None or _is_shadow(first, _nearer_thread(first, own)).mean() < LEAST_SHARE:
        return None
    seen = _seen(soft, ground, pixel)
    nearer = _calmed(_nearer_thread(seen, own), pixel, thread.shape)
    is_thread, is_shadow = nearer > APART, _is_shadow(seen, nearer)
    if not is_shadow.any() or is_thread.sum() < TOLD_SHARE * np.count_nonzero(~is_shadow):
        return None
    gone = pixel[is_shadow][_beside(pixel[is_shadow], pixel[is_thread], thread, reach_px)]
    return _with_rests(gone, pixel[is_thread], pixel[nearer < -APART], thread) if len(gone) else None


def _with_rests(
    gone: Int64[np.ndarray, "g"],
    own: Int64[np.ndarray, "t"],
    of_ground: Int64[np.ndarray, "b"],
    thread: Bool[np.ndarray, "h w"],
) -> Bool[np.ndarray, "h w"]:
    """The shadow with ground about it, and with smaller pieces cut off that are mostly not known to be thread.

    Args:
        own, of_ground: segmented pixels that are known to be thread, and those that are rather ground.
    """
    shadow = np.zeros(thread.shape, np.uint8)
    shadow.ravel()[gone] = 1
    shadow |= _ground_about(shadow, own, of_ground).view(np.uint8)
    rest = thread.view(np.uint8) & (1 - shadow)
    count, labelled = cv2.connectedComponents(rest, connectivity=8)
    piece = np.asarray(labelled, np.int32)
    beside = _touching(piece, shadow)
    size, of_thread = (np.bincount(pieces, minlength=count) for pieces in (piece.ravel(), piece.ravel()[own]))
    cut_off = np.zeros(count, bool)
    cut_off[beside] = (of_thread[beside] < TOLD_SHARE * size[beside]) & (size[beside] < len(gone))
    cut_off[0] = False
    return np.asarray((shadow > 0) | cut_off[piece], bool)


def _ground_about(
    shadow: UInt8[np.ndarray, "h w"], own: Int64[np.ndarray, "t"], of_ground: Int64[np.ndarray, "b"]
) -> Bool[np.ndarray, "h w"]:
    """Ground that touches a shadow beside the thread: left there, it would pass for a branch of the thread."""
    told, ground = np.zeros(shadow.shape, np.uint8), np.zeros(shadow.shape, np.uint8)
    told.ravel()[own], ground.ravel()[of_ground] = 1, 1
    # the thread's own edge is a mixture
    ground &= (cv2.dilate(told, np.ones((5, 5), np.uint8)) | shadow) ^ 1
    count, labelled = cv2.connectedComponents(ground, connectivity=8)
    piece = np.asarray(labelled, np.int32)
    found = np.zeros(count, bool)
    found[_touching(piece, shadow)] = True
    # what reaches farther may be thread that is not known
    found[piece[(ground > 0) & (_depth(1 - told) > CLOSE * _width(told))]] = False
    found[0] = False
    return found[piece]


def _touching(piece: Int32[np.ndarray, "h w"], shadow: UInt8[np.ndarray, "h w"]) -> Int32[np.ndarray, "k"]:
    """The numbers of what lies beside the shadow."""
    return np.unique(piece[cv2.dilate(shadow, np.ones((3, 3), np.uint8)) > 0])


def _ground(image: Image, thread: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "r c 3"]:
    """The colour of the ground hereabouts, in a smaller image; 0 where nothing but thread is."""
    size = -(-image.shape[1] // SMALL), -(-image.shape[0] // SMALL)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    covered = cv2.resize(thread.view(np.uint8) * np.uint8(255), size, interpolation=cv2.INTER_AREA)
    bare = cv2.dilate(covered, np.ones((BESIDE_MASK, BESIDE_MASK), np.uint8)) == 0
    side = AVERAGED, AVERAGED
    weight = cv2.blur(bare.astype(np.float32), side)
    total = cv2.blur((small * bare[..., None].view(np.uint8)).astype(np.float32), side)
    return np.asarray(total / np.maximum(weight, np.float32(1e-4))[..., None], np.float32)


def _seen(soft: Image, ground: Float32[np.ndarray, "r c 3"], pixel: Int64[np.ndarray, "n"]) -> _Seen:
    row, column = np.divmod(pixel, soft.shape[1])
    colour = soft[row, column].astype(np.float32)
    at = np.stack((row, column)) // SMALL + AROUND[:, :, None]
    of_ground = ground[at[:, 0].clip(0, ground.shape[0] - 1), at[:, 1].clip(0, ground.shape[1] - 1)]
    bright = np.sqrt((of_ground**2).sum(axis=2))
    along = (of_ground * colour).sum(axis=2) / np.maximum(bright, 1.0)
    brightness = np.sqrt((colour**2).sum(axis=1))
    off = np.sqrt(np.maximum(brightness**2 - along.max(axis=0) ** 2, 0.0))
    return _Seen(colour, off, brightness / np.maximum(bright.max(axis=0), 1.0))


def _colour_of_thread(seen: _Seen) -> Float32[np.ndarray, "3"] | None:
    """The unit vector of the thread's colour; None where it is none of its own."""
    hue = _unit(seen.colour)
    unlike = seen.off_ground / np.maximum(np.sqrt((seen.colour**2).sum(axis=1)), 1.0)
    of_thread = unlike >= np.median(unlike)
    for _ in range(2):
        own = _unit(np.median(hue[of_thread], axis=0))
        of_thread = _nearer_thread(seen, own) > 0
        if of_thread.sum() < LEAST_PIXELS:
            return None
    return _unit(np.median(hue[of_thread], axis=0)) if np.median(seen.off_ground[of_thread]) >= LEAST_COLOUR else None


def _unit(vectors: Float32[np.ndarray, "*n 3"]) -> Float32[np.ndarray, "*n 3"]:
    return np.asarray(vectors / np.maximum(np.sqrt((vectors**2).sum(axis=-1, keepdims=True)), 1e-6), np.float32)


def _nearer_thread(seen: _Seen, own: Float32[np.ndarray, "3"]) -> Float32[np.ndarray, "n"]:
    """By how much each colour lies nearer to the line of the thread's than to that of the ground's."""
    along = seen.colour @ own
    return seen.off_ground - np.sqrt(np.maximum((seen.colour**2).sum(axis=1) - along**2, 0.0))


def _is_shadow(seen: _Seen, nearer: Float32[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    return (nearer < -APART) & (seen.off_ground < OF_GROUND) & (seen.brightness < BRIGHTEST)


def _calmed(
    values: Float32[np.ndarray, "n"], pixel: Int64[np.ndarray, "n"], shape: tuple[int, ...]
) -> Float32[np.ndarray, "n"]:
    """Each value averaged with those of other pixels around it."""
    both = np.zeros((shape[0] * shape[1], 2), np.float32)
    both[pixel, 0], both[pixel, 1] = values, 1.0
    total, count = cv2.blur(both.reshape(*shape, 2), (CALM, CALM)).reshape(-1, 2)[pixel].T
    return np.asarray(total / count, np.float32)


def _beside(
    shadow: Int64[np.ndarray, "s"], thread: Int64[np.ndarray, "t"], segmented: Bool[np.ndarray, "h w"], reach_px: float
) -> Bool[np.ndarray, "s"]:
    """Which pixels are of a region that lies beside thread, and not before its end or within it."""
    shape = segmented.shape
    own, regions = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    own.ravel()[thread], regions.ravel()[shadow] = 1, 1
    width = _width(own)
    thick = 2.0 * cv2.dilate(_depth(segmented.view(np.uint8)), np.ones((5, 5), np.uint8)).ravel()[shadow] - 1.0
    count, labelled = cv2.connectedComponents(regions, connectivity=8)
    region = np.asarray(labelled, np.int32).ravel()[shadow]
    at, of_thread = (np.stack(np.divmod(pixels, shape[1]), axis=1).astype(np.float64) for pixels in (shadow, thread))
    away, nearest = (np.asarray(found) for found in cKDTree(of_thread).query(at))
    way = of_thread[nearest] - at
    found = np.zeros(count, bool)
    for number in np.flatnonzero(np.bincount(region, minlength=count) >= SPECK).tolist():
        here = region == number
        along, across = np.abs(way[here] @ _axes(at[here])).T
        beside = (across >= along) & (away[here] <= reach_px)
        apart = np.median(away[here]) >= AWAY * width or np.median(thick[here]) >= THICKER * width
        found[number] = apart and beside.mean() >= BESIDE_SHARE
    return found[region]


def _axes(points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "2 2"]:
    """Unit vectors as columns: the direction in which points spread farthest, and the one across it."""
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2].T, np.float64)


def _width(strips: UInt8[np.ndarray, "h w"]) -> float:
    """Of strips: the distance to the nearest pixel beyond their edges averages a quarter of it, and a half."""
    return max(1.0, 4.0 * float(cv2.mean(_depth(strips), strips)[0]) - 2.0)


def _depth(mask: UInt8[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    return np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, 3), np.float32)
