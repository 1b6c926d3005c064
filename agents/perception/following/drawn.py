"""Masks of a thread that was followed: what its centrelines cover, as wide as they say."""

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.perception.following.appearance import pieces_of
from agents.perception.following.follow import Followed

SHIFT_BITS = 3
"""OpenCV draws to fractions of a pixel in fixed point."""
EVERY = 3
"""Of the points, which lie a pixel apart, so many make a corner."""
OVER_CUT_WIDTHS = 1.5
"""Pieces are cut about so far before a crossing, which is thread too."""
BORDER_PX = 0.5
"""Pixels on an outline are filled too."""
FULL = 255


def mask_along(followed: Followed, shape: tuple[int, ...]) -> UInt8[np.ndarray, "h w"]:
    """Coverage by the thread, 0 or 255: each piece as wide as it is, on to the crossings that cut it."""
    mask = np.zeros(shape[:2], np.uint8)
    lines, trail = followed.lines, followed.trail
    pieces = pieces_of(lines)
    for k, (a, b) in enumerate(zip(pieces.first.tolist(), pieces.last.tolist(), strict=True)):
        some = np.append(np.arange(a, b, EVERY), b)
        point, width = lines.point_px[some], lines.width_px[some]
        before = () if trail.loose_start[k] else (_beyond(point, width[0]),)
        after = () if trail.loose_end[k] else (_beyond(point[::-1], width[-1]),)
        whole = np.concatenate((*before, point, *after))
        half = np.concatenate((width[: len(before)], width, width[len(width) - len(after) :])) / 2
        outline = _outline(whole, np.maximum(half - BORDER_PX, 0.0))
        fixed = np.rint(outline * (1 << SHIFT_BITS)).astype(np.int32)[:, None]
        cv2.fillPoly(mask, [fixed], FULL, cv2.LINE_8, SHIFT_BITS)
    return mask


def _outline(point: Float64[np.ndarray, "n 2"], half_px: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "m 2"]:
    """A line's, so far to either side: back along the other one."""
    ahead = np.concatenate((point[1:], point[-1:]))
    u, v = (ahead - np.concatenate((point[:1], point[:-1]))).T
    aside = np.stack((-v, u), axis=1) * (half_px / np.maximum(np.sqrt(u * u + v * v), 1e-9))[:, None]
    return np.concatenate((point + aside, (point - aside)[::-1]))


def _beyond(point: Float64[np.ndarray, "n 2"], width: float) -> Float64[np.ndarray, "1 2"]:
    """Straight on from the first of these points."""
    way = point[0] - point[min(len(point) - 1, 2)]
    return point[:1] + OVER_CUT_WIDTHS * width * way / max(float(np.hypot(*way)), 1e-9)
