"""What both images show around a suture needle: lines that look like needle or thread.

The network that tells classes calls parts of a needle thread and parts of a thread needle, since they look alike. What
it takes for either is one line, whose middle is found as that of a thread is; how much of each it sees travels along.
It is asked in full resolution: everywhere where thread was looked for everywhere, and else only around what it took for
a needle in a small copy, and around the ends of the thread, since a needle is swaged onto one.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from agents.perception.centrelines.centrelines import thread_centrelines
from agents.perception.occluders import map_image, map_shape
from agents.perception.segmentation.classes import Kind, scores_where
from schemas.messages import (
    FrameStamp,
    Image,
    NeedleObservations,
    NeedleView,
    Occluder,
    RectifiedStereo,
    ThreadObservations,
)
from shared.images import decode_image
from shared.in_parallel import of_both

REACH_SHARE = 0.16
"""Of the image's width, around where a needle may be: as far as one of 18 mm across reaches at 10 cm."""
LEAST_SCORE = 0.3
"""Of a pixel, for thread and needle together, and for an instrument."""
LEAST_HIDDEN = 0.25
"""Of a pixel of the small copy: so much of it shows an instrument."""

Pixels = UInt8[np.ndarray, "h w 3"]


def needle_observed(
    stamp: FrameStamp, camera: RectifiedStereo, left: Pixels, right: Pixels, observed: ThreadObservations
) -> NeedleObservations:
    """What both rectified images show around a needle.

    Args:
        left, right: in line.
        observed: of the same frame: where its thread ends, and where a needle was seen in small copies.
    """
    maps = observed.occluders
    if maps is None or not observed.candidates or observed.looked_sequence == stamp.sequence:
        everywhere = np.ones(left.shape[:2], bool)
        where = everywhere, everywhere
    else:
        meant = observed.candidates[0]
        where = (
            needle_region(left.shape[:2], decode_image(maps.left), meant.left_px[[0, -1]]),
            needle_region(right.shape[:2], decode_image(maps.right), meant.right_px[[0, -1]]),
        )
    return NeedleObservations(stamp, camera, *of_both(view_of, (left, where[0]), (right, where[1])))


def needle_region(
    shape: tuple[int, int], occluders: UInt8[np.ndarray, "r c"], ends_px: Float64[np.ndarray, "k 2"]
) -> Bool[np.ndarray, "h w"]:
    """Where in an image a needle may be."""
    around = (occluders == Occluder.NEEDLE.value).astype(np.uint8)
    column, row = np.clip(ends_px * around.shape[1] / shape[1], 0, np.array(around.shape[::-1]) - 1).astype(np.int64).T
    around[row, column] = 1
    side = 2 * round(REACH_SHARE * around.shape[1]) + 1
    reached = np.asarray(cv2.dilate(around, np.ones((side, side), np.uint8)))
    return np.asarray(cv2.resize(reached, shape[::-1], interpolation=cv2.INTER_NEAREST)) > 0


def view_of(image: Pixels, where: Bool[np.ndarray, "h w"]) -> NeedleView:
    """What looks like needle or thread within a part of an image."""
    scores = scores_where(image, where)
    share = scores[..., Kind.THREAD] + scores[..., Kind.NEEDLE]
    mask = np.where(share >= LEAST_SCORE, np.uint8(255), np.uint8(0))
    lines = thread_centrelines(image, mask)
    place = lines.point_px.astype(np.float32)
    of_needle = _at(scores[..., Kind.NEEDLE], place) / np.maximum(_at(share, place), LEAST_SCORE)
    # edges of a glint are no edges of the needle: it is as wide as what looks like it
    depth = np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    width_px = np.maximum(2.0 * _at(depth, place).astype(np.float64), 1.0)
    instrument = (scores[..., Kind.INSTRUMENT] >= LEAST_SCORE).astype(np.float32)
    small = cv2.resize(instrument, map_shape(image.shape)[::-1], interpolation=cv2.INTER_AREA)
    return NeedleView(
        replace(lines, width_px=width_px),
        np.clip(of_needle, 0.0, 1.0).astype(np.float64),
        _at(image, place).astype(np.uint8),
        _map(small >= LEAST_HIDDEN),
    )


def _map(hides: Bool[np.ndarray, "r c"]) -> Image:
    return map_image(np.where(hides, np.uint8(Occluder.TOOL.value), np.uint8(0)))


def _at(values: np.ndarray, place: Float32[np.ndarray, "n 2"]) -> np.ndarray:
    """The means of 3 by 3 pixels around places."""
    if not len(place):
        return np.zeros((0, *values.shape[2:]), values.dtype)
    mean = np.asarray(cv2.blur(np.ascontiguousarray(values), (3, 3)))
    return cv2.remap(mean, place[:, :1], place[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[:, 0]
