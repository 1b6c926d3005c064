"""What is known to be in a part of one image while a thread is followed: what a glance need not wonder about."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.candidates.drawn import SPACING_PX
from agents.perception.following.appearance import pieces_of
from schemas.messages import Centrelines, ThreadObservations, Trail
from shared.images import decode_image

BESIDE_SHARE = 0.01
"""Of the width: so near to a followed thread all thread is its own."""
OTHERS_SHARE = 0.03
"""Of the width: how far threads that are not followed may have moved since they were seen."""
BESIDE_OCCLUDER_CELLS = 2
"""Of the map of occluders, which is coarse."""
GAP = 3.0
"""Times the usual distance of the points of a line that travels: there it is cut."""

Box = tuple[slice, slice]


@dataclass(frozen=True)
class Known:
    """One image's thread, and what else is known to be in a box of it.

    Fields:
        lines: of the thread that is followed.
        cuts_px: where pieces of it are cut, and do not end.
        others_px: points of threads that are not.
        own, elsewhere: whether pixels of the box lie beside the thread that is followed; whether at something else
            that is known.
    """

    lines: Centrelines
    cuts_px: Float64[np.ndarray, "c 2"]
    others_px: Float64[np.ndarray, "o 2"]
    own: Bool[np.ndarray, "h w"]
    elsewhere: Bool[np.ndarray, "h w"]


def known_in(observed: ThreadObservations, eye: int, coverage: UInt8[np.ndarray, "h w"], box: Box) -> Known:
    """What is known of a box in one eye's image.

    Args:
        observed: of a followed thread, with candidates and occluders.
        eye: 0 for the left one, 1 for the right one.
        coverage: by the followed thread, of the whole image.
    """
    lines = (observed.centrelines_left, observed.centrelines_right)[eye]
    trail = (observed.trail_left, observed.trail_right)[eye]
    listed = [(candidate.left_px, candidate.right_px)[eye] for candidate in observed.candidates[1:]]
    others = [line for line in listed if len(line) and not _is_followed(line, coverage)]
    reach = round(BESIDE_SHARE * coverage.shape[1])
    own = cv2.dilate(coverage[box], np.ones((2 * reach + 1,) * 2, np.uint8))
    return Known(
        lines,
        _cuts_px(lines, trail),
        np.concatenate((np.zeros((0, 2)), *others)),
        np.asarray(own) > 0,
        _elsewhere(observed, eye, others, coverage.shape, box),
    )


def _is_followed(line: Float64[np.ndarray, "n 2"], coverage: UInt8[np.ndarray, "h w"]) -> bool:
    """Whether a thread that is not the one that is meant is followed with it."""
    u, v = (np.rint(line[:, k]).astype(np.intp).clip(0, coverage.shape[1 - k] - 1) for k in (0, 1))
    return bool((coverage[v, u] > 0).mean() > 0.5)


def _cuts_px(lines: Centrelines, trail: Trail | None) -> Float64[np.ndarray, "c 2"]:
    if trail is None:
        return np.zeros((0, 2))
    pieces = pieces_of(lines)
    return lines.point_px[np.concatenate((pieces.first[~trail.loose_start], pieces.last[~trail.loose_end]))]


def _elsewhere(
    observed: ThreadObservations,
    eye: int,
    others: Sequence[Float64[np.ndarray, "n 2"]],
    shape: tuple[int, ...],
    box: Box,
) -> Bool[np.ndarray, "h w"]:
    """Where threads that are not followed were, and what may hide thread."""
    rows, columns = box
    about = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.uint8)
    wide, corner = round(2 * OTHERS_SHARE * shape[1]), np.array((columns.start, rows.start))
    for line in others:
        step = np.linalg.norm(np.diff(line, axis=0), axis=1)
        parts = np.split(np.rint(line - corner).astype(np.int32), np.flatnonzero(step > GAP * SPACING_PX) + 1)
        cv2.polylines(about, [part[:, None] for part in parts], False, 255, wide)
    if observed.occluders is not None:
        image = observed.occluders.right if eye else observed.occluders.left
        side = 2 * BESIDE_OCCLUDER_CELLS + 1
        near = cv2.dilate((decode_image(image) > 0).astype(np.uint8), np.ones((side, side), np.uint8))
        occluded = np.asarray(cv2.resize(near, shape[1::-1], interpolation=cv2.INTER_NEAREST))[box]
        return (about > 0) | (occluded > 0)
    return about > 0
