"""How a thread and the ground beside it look along centrelines: what the next frame knows them by."""

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from agents.perception.centrelines.along import STRIDE, Pieces, blurred, gaussian, numbered
from agents.perception.centrelines.edges import COLOUR_NOISE, LIGHT
from agents.perception.centrelines.profiles import sample
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
    """How much of each place is thread, 0 to 1: the lesser of what the ground on either side would have it be.

    Mixtures of both colours, as for edges: light and shadow change thread and ground alike.
    """
    channels = [channel.astype(np.float32) for channel in cv2.split(seen)]
    known = np.ascontiguousarray(colours.transpose(1, 2, 0), np.float64)
    near, far = zip(*_mixing(known[0], known[1:]), strict=True)
    return np.minimum(_share(channels, near), _share(channels, far))


def _mixing(
    thread: Float64[np.ndarray, "3 m"], ground: Float64[np.ndarray, "2 3 m"]
) -> tuple[Float32[np.ndarray, "2 4 m"], Float32[np.ndarray, "2 4 m"]]:
    """Weights of the channels, and what is added to them, of how much is thread and how much is ground."""
    even, t, g = 1 / LIGHT**2, thread / COLOUR_NOISE, ground / COLOUR_NOISE
    tt, gg, tg = (t * t).sum(axis=0) + even, (g * g).sum(axis=1) + even, (t * g).sum(axis=1) + even
    tt, gg = tt + 1, gg + 1
    scale = 1 / (tt * gg - tg**2)
    weights = np.empty((2, *ground.shape[:1], 4, ground.shape[2]), np.float32)
    weights[0, :, :3] = (t * gg[:, None] - g * tg[:, None]) * scale[:, None] / COLOUR_NOISE
    weights[1, :, :3] = (g * tt - t * tg[:, None]) * scale[:, None] / COLOUR_NOISE
    weights[0, :, 3] = even * (gg - tg) * scale
    weights[1, :, 3] = even * (tt - tg) * scale
    return weights[0], weights[1]


def _share(
    channels: list[Float32[np.ndarray, "t m"]], mixing: tuple[Float32[np.ndarray, "4 m"], ...]
) -> Float32[np.ndarray, "t m"]:
    of_thread, of_ground = (_weighted(channels, weights) for weights in mixing)
    return of_thread / np.maximum(of_ground + of_thread, np.float32(1e-6))


def _weighted(
    channels: list[Float32[np.ndarray, "t m"]], weights: Float32[np.ndarray, "4 m"]
) -> Float32[np.ndarray, "t m"]:
    total = channels[0] * weights[0] + weights[3] + channels[1] * weights[1] + channels[2] * weights[2]
    return np.maximum(total, np.float32(0))
