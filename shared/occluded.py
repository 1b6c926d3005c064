"""Where a line in an image lies behind, or goes on behind, what may hide thread.

Occluders come as a smaller copy of an image that is not 0 where something may hide thread (schemas/messages).
"""

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from schemas.messages import Occluder

OVER_SHARE = 0.012
"""Of the image's width: over so much of a line the direction of its end is told."""
BEYOND_SHARE = 0.02
"""Of the image's width: what begins so far beyond an end may hide the rest, since a mask ends before a dark border."""
STEPS = 9


def is_occluded(
    points_px: Float64[np.ndarray, "*n 2"], occluders: UInt8[np.ndarray, "r c"], image_width: int
) -> Bool[np.ndarray, "*n"]:
    """Whether places of the image lie on an occluder; none outside of the image does."""
    share = occluders.shape[1] / image_width
    at = np.rint((points_px + 0.5) * share - 0.5)
    inside = ((at >= 0) & (at < occluders.shape[::-1])).all(axis=-1)
    u, v = (at[..., k].clip(0, occluders.shape[1 - k] - 1).astype(np.intp) for k in (0, 1))
    return (occluders[v, u] > 0) & inside


def hidden_ends(
    line_px: Float64[np.ndarray, "n 2"], occluders: UInt8[np.ndarray, "r c"], image_width: int
) -> Bool[np.ndarray, "2"]:
    """Whether the first and the last end of a line go on into an occluder.

    At a needle a thread ends: it is swaged into it.

    Args:
        line_px: places in order, at least two.
    """
    step = float(np.median(np.linalg.norm(np.diff(line_px, axis=0), axis=1)))
    back = min(len(line_px) - 1, max(1, round(OVER_SHARE * image_width / max(step, 1e-6))))
    outward = line_px[[0, -1]] - line_px[[back, -1 - back]]
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    beyond = np.linspace(0.0, BEYOND_SHARE * image_width, STEPS)
    places = line_px[[0, -1]][:, None] + beyond[None, :, None] * outward[:, None]
    hides = np.where(occluders == Occluder.NEEDLE.value, np.uint8(0), occluders)
    return np.asarray(is_occluded(places, hides, image_width).any(axis=1))
