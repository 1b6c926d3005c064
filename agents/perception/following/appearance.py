"""How a thread and the ground beside it look along centrelines: what the next frame knows them by."""

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from agents.perception.centrelines.along import Pieces, blurred, gaussian
from agents.perception.centrelines.edges import COLOUR_NOISE, LIGHT
from agents.perception.centrelines.profiles import sample
from schemas.messages import Centrelines

EVERY = 4
"""Of the points, which lie a pixel apart, so many as are looked at."""
ALONG = 2.0
"""Standard deviation, in these points, of the average along the thread in which colours are seen."""
THREAD_SHARES = np.array([-0.25, 0.0, 0.25])
"""Of the width: where a profile shows the thread's own colour."""
GROUND_PX = np.array([2.0, 3.0, 4.0])
"""Beyond the thread's edges: where it shows the ground's."""

Colours = UInt8[np.ndarray, "m 3 3"]


def pieces_of(lines: Centrelines) -> Pieces:
    """The pieces of centrelines, numbered without gaps."""
    return Pieces(np.cumsum(np.append(lines.piece[:1] >= 0, lines.piece[1:] > lines.piece[:-1])) - 1)


def some_of(pieces: Pieces) -> Int64[np.ndarray, "m"]:
    """Every so many points of each piece, and its last one."""
    return np.flatnonzero((pieces.before % EVERY == 0) | (pieces.after == 0))


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
    """How much of each place is thread, 0 to 1: the lesser of what the ground on either side would have it be.

    Mixtures of both colours, as for edges: light and shadow change thread and ground alike.
    """
    channels = [np.ascontiguousarray(seen[..., k], np.float32) for k in range(3)]
    thread, near, far = colours.transpose(1, 2, 0).astype(np.float64)
    return np.minimum(_share(channels, thread, near), _share(channels, thread, far))


def _share(
    channels: list[Float32[np.ndarray, "t m"]], thread: Float64[np.ndarray, "3 m"], ground: Float64[np.ndarray, "3 m"]
) -> Float32[np.ndarray, "t m"]:
    even, t, g = 1 / LIGHT**2, thread / COLOUR_NOISE, ground / COLOUR_NOISE
    tt, gg, tg = ((one * other).sum(axis=0) + even for one, other in ((t, t), (g, g), (t, g)))
    tt, gg = tt + 1, gg + 1
    scale = 1 / (tt * gg - tg**2)
    of_thread = _weighted(channels, (t * gg - g * tg) * scale, even * (gg - tg) * scale)
    of_ground = _weighted(channels, (g * tt - t * tg) * scale, even * (tt - tg) * scale)
    return of_thread / np.maximum(of_thread + of_ground, np.float32(1e-6))


def _weighted(
    channels: list[Float32[np.ndarray, "t m"]], weight: Float64[np.ndarray, "3 m"], level: Float64[np.ndarray, "m"]
) -> Float32[np.ndarray, "t m"]:
    of_channel = (weight / COLOUR_NOISE).astype(np.float32)
    total = channels[0] * of_channel[0] + level.astype(np.float32)
    for channel, share in zip(channels[1:], of_channel[1:], strict=True):
        total += channel * share
    return np.maximum(total, np.float32(0), out=total)
