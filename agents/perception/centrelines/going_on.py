"""How far a thread goes on in the image beyond the end of its mask, along its own direction.

A segmenter may stop short where the ground changes, as at the edge of an instrument. What is seen beyond is thread for
as long as it has the thread's colour and the ground on neither side does. Where that leads to another line the end
stays: there the mask has a gap, and not an end.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8
from scipy.spatial import cKDTree

from agents.perception.centrelines.along import medians
from agents.perception.centrelines.profiles import seen_around

FARTHEST_PX = 24
"""Straight on, a thread is not where it is looked for much farther away."""
WITHIN_WIDTHS = np.linspace(-0.25, 0.25, 5)
"""To either side of the middle, where nothing but thread is seen."""
BESIDE_PX = np.array([2.0, 3.0, 4.0])
"""Beyond the thread's edges: nothing but ground."""
BODY_WIDTHS = 3.0
"""Before the end, without the last one: so many widths tell the thread's colour."""
LEAST_CONTRAST = 25.0
"""Between thread and ground, in grey levels."""
LIKE_THREAD = 0.35
"""How far from the thread's colour, of how far the ground of either side lies from it."""
CALM_PX = 3


def goes_on_px(
    image: UInt8[np.ndarray, "h w 3"],
    end: Float64[np.ndarray, "e 2"],
    outward: Float64[np.ndarray, "e 2"],
    width: Float64[np.ndarray, "e"],
    lines: Float64[np.ndarray, "n 2"],
) -> Float64[np.ndarray, "e"]:
    """How many pixels beyond each end nothing but thread is seen; 0 where that leads to another line.

    Args:
        outward: unit vectors.
        width: of the thread.
        lines: all points of centrelines.
    """
    steps = np.arange(1.0, FARTHEST_PX + 1)
    beyond = end[:, None] + steps[:, None] * outward[:, None]
    before = -width[:, None] * np.linspace(BODY_WIDTHS, 1.0, 9)
    at = np.hstack((before, np.broadcast_to(steps, (len(end), FARTHEST_PX))))
    beside = 0.5 * width[:, None] + BESIDE_PX
    across = np.hstack((width[:, None] * WITHIN_WIDTHS, -beside, beside))
    seen = seen_around(image, end, outward, at, across)
    middle, sides = seen[:, :, :5].mean(axis=2), seen[:, :, 5:].reshape(*seen.shape[:2], 2, 3, 3).mean(axis=3)
    thread = medians(middle[:, : before.shape[1]].swapaxes(0, 1))[:, None]
    calm = np.asarray(cv2.blur(middle[:, before.shape[1] :], (CALM_PX, 1), borderType=cv2.BORDER_REPLICATE))
    unlike = np.linalg.norm(calm.reshape(len(end), -1, 3) - thread, axis=2)
    contrast = np.linalg.norm(sides[:, before.shape[1] :] - thread[:, :, None], axis=3).min(axis=2)
    is_thread = (contrast >= LEAST_CONTRAST) & (unlike <= LIKE_THREAD * contrast) & _inside(image, beyond)
    seen_on = np.logical_and.accumulate(is_thread, axis=1)
    # the end itself is a step away for each step
    at_other = np.asarray(cKDTree(lines).query(beyond)[0]) <= np.minimum(steps - 1.0, width[:, None])
    return np.where((seen_on & at_other).any(axis=1), 0.0, seen_on.sum(axis=1))


def _inside(image: UInt8[np.ndarray, "h w 3"], points: Float64[np.ndarray, "e a 2"]) -> Bool[np.ndarray, "e a"]:
    return np.all((points >= 0) & (points <= np.array(image.shape[1::-1]) - 1.0), axis=2)
