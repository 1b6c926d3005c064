"""How a thread and the ground beside it look along centrelines: what the next frame knows them by."""

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from agents.perception.centrelines.along import STRIDE, Pieces, blurred, gaussian, numbered
from agents.perception.centrelines.mixture import share_of_mixture
from agents.perception.centrelines.profiles import by_channel, sample
from schemas.messages import Centrelines

EVERY = 4
"""One in so many points is looked at, which lie a pixel apart; of observations, whose points lie STRIDE pixels apart,
one in EVERY / STRIDE is, and they are the same."""
ALONG = 2.0
"""Standard deviation, in these points, of the average along the thread in which colours are seen."""
THREAD_SHARES = np.array([-0.25, 0.0, 0.25])
"""Of the width: where a profile shows the thread's own colour."""
GROUND_PX = np.array([2.0, 3.0, 4.0])
"""Beyond the thread's edges: where it shows the ground's."""

Colours = UInt8[np.ndarray, "m 3 3"]


def pieces_of(lines: Centrelines) -> Pieces:
    """The pieces of centrelines, numbered without gaps."""
    return Pieces(numbered(lines.piece))


def some_of(pieces: Pieces) -> Int64[np.ndarray, "m"]:
    """Every so many points of each piece, and its last one."""
    return pieces.every(EVERY)


def some_of_observed(pieces: Pieces) -> Int64[np.ndarray, "m"]:
    """The same points of the pieces of observations."""
    return pieces.every(EVERY // STRIDE)


def colours_across(
    image: UInt8[np.ndarray, "h w 3"],
    point: Float64[np.ndarray, "m 2"],
    normal: Float64[np.ndarray, "m 2"],
    width_px: Float64[np.ndarray, "m"],
    pieces: Pieces,
) -> Colours:
    """The colour of the thread, and of the ground on either side of it, at each point."""
    half = width_px / 2
    at = np.concatenate(
        (
            THREAD_SHARES[:, None] * width_px,
            -half - GROUND_PX[:, None],
            half + GROUND_PX[:, None],
        )
    )
    seen = sample(image, point, normal, at, cv2.BORDER_REPLICATE).astype(np.float32)
    means = seen.reshape(3, -1, *seen.shape[1:]).mean(axis=1)
    return np.rint(blurred(means, pieces, gaussian(ALONG))).astype(np.uint8).transpose(1, 0, 2)


def share_of_thread(seen: UInt8[np.ndarray, "t m 3"], colours: Colours) -> Float32[np.ndarray, "t m"]:
    """How much of each place is thread, 0 to 1: the lesser of what the ground on either side would have it be."""
    channels = by_channel(seen.astype(np.float32))
    thread, *grounds = np.ascontiguousarray(colours.transpose(1, 2, 0), np.float64)
    near, far = (share_of_mixture(channels, thread, ground) for ground in grounds)
    return np.minimum(near, far)
