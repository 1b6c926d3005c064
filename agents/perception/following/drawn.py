"""Masks of a thread that was followed: what its centrelines cover, as wide as they say."""

import cv2
import numpy as np
from jaxtyping import UInt8

from agents.perception.following.follow import Followed, pieces_of

SHIFT_BITS = 3
"""OpenCV draws to fractions of a pixel in fixed point."""
OVER_CUT_WIDTHS = 1.5
"""Pieces are cut about so far before a crossing, which is thread too."""
FULL = 255


def mask_along(followed: Followed, shape: tuple[int, ...]) -> UInt8[np.ndarray, "h w"]:
    """Coverage by the thread, 0 or 255: a line of each piece's median width, on to the crossings that cut it."""
    mask = np.zeros(shape[:2], np.uint8)
    lines, trail = followed.lines, followed.trail
    pieces = pieces_of(lines)
    for k, (a, b) in enumerate(zip(pieces.first.tolist(), pieces.last.tolist(), strict=True)):
        point, width = lines.point_px[a : b + 1], float(np.median(lines.width_px[a : b + 1]))
        before = () if trail.loose_start[k] else (_beyond(point, width),)
        after = () if trail.loose_end[k] else (_beyond(point[::-1], width),)
        whole = np.concatenate((*before, point, *after))
        fixed = np.rint(whole * (1 << SHIFT_BITS)).astype(np.int32)[:, None]
        cv2.polylines(mask, [fixed], False, FULL, max(1, round(width)), cv2.LINE_8, SHIFT_BITS)
    return mask


def _beyond(point: np.ndarray, width: float) -> np.ndarray:
    """Straight on from the first of these points."""
    inner = point[min(len(point) - 1, max(1, round(width)))]
    way = point[0] - inner
    return point[:1] + OVER_CUT_WIDTHS * width * way / max(float(np.hypot(*way)), 1e-9)
