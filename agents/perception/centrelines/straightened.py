"""The thread straightened: what the image shows across points of a curve, in units that all threads share."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from agents.perception.centrelines.along import Pieces, blurred, gaussian, smoothed

PLACES = np.linspace(-1.0, 1.0, 25, dtype=np.float32)
"""Where a profile is seen, as shares of its reach."""
BEYOND_PX = 3.0
"""A profile reaches a width and so much to either side: blur is in pixels however thin the thread is."""
GROUND_FROM_PX, THREAD_SHARE, THREAD_PX = 1.5, 0.25, 0.25
"""The ground is what lies farther from the edges; the thread's colour is that of its middle half, and a bit."""
PLAIN, PLAIN_STRIDE = 3.0, 4
"""Grey levels: half of a plain ground differs by less from its median, and half of any tissue by twice as much.

A quarter of all points tells."""
ALONG = 4.0
"""Standard deviation, in points, of the average along the thread in which both colours are seen."""
WIDTH_ALONG_PX = 8.0
LEAST_WIDTH, MOST_WIDTH = 0.6, 1.5
"""Of the whole thread's: what is narrower or wider was misjudged."""
NARROWEST_PX, WIDEST_PX = 1.0, 40.0
COLOUR_NOISE, LIGHT = 5.0, 0.15
"""As for edges: deviations of a colour, in grey levels, and of how bright thread and ground are."""
CHANNELS, NUMBERS = 6, 9
LEAST_SHARE, MOST_SHARE = -4.0, 4.0
LEAST_CONTRAST = 8.0
USUAL_WIDTH_PX, USUAL_CONTRAST, USUAL_LEVEL = 5.0, 30.0, 100.0
LEAST = 1e-3


def usual_width_px(width_px: Float64[np.ndarray, "n"], pieces: Pieces) -> Float64[np.ndarray, "n"]:
    """The thread's width hereabouts, whatever single profiles say."""
    typical = float(np.median(width_px))
    clipped = np.clip(width_px, LEAST_WIDTH * typical, MOST_WIDTH * typical)[:, None]
    return smoothed(clipped, pieces, gaussian(WIDTH_ALONG_PX))[:, 0].clip(NARROWEST_PX, WIDEST_PX)


def reach_px(width_px: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """How far a profile of a thread of that width reaches to either side."""
    return width_px + BEYOND_PX


def seen_across(
    image: UInt8[np.ndarray, "h w 3"],
    point: Float64[np.ndarray, "n 2"],
    normal: Float64[np.ndarray, "n 2"],
    reach: Float64[np.ndarray, "n"],
    places: Float32[np.ndarray, "t"] = PLACES,
) -> Float32[np.ndarray, "n t 3"]:
    """Colours across each point, from -reach to reach along its normal."""
    at = reach[:, None] * places
    u, v = ((point[:, k, None] + normal[:, k, None] * at).astype(np.float32) for k in (0, 1))
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def has_plain_ground(colour: Float32[np.ndarray, "n t 3"], width_px: Float64[np.ndarray, "n"]) -> bool:
    """Whether the ground is of one colour everywhere beside the thread."""
    some, width = colour[::PLAIN_STRIDE], width_px[::PLAIN_STRIDE, None]
    ground = some[np.abs(PLACES) * reach_px(width) > width / 2 + GROUND_FROM_PX]
    return bool(np.median(np.abs(ground - np.median(ground, axis=0)).mean(axis=1)) < PLAIN)


def straightened(
    colour: Float32[np.ndarray, "n t 3"], width_px: Float64[np.ndarray, "n"], pieces: Pieces
) -> Float32[np.ndarray, "n c"]:
    """Profiles in units that all threads share; their reach is that of their width.

    Of each place: its colour less the ground's, over the contrast; its brightness against the ground's; and how much of
    the thread's colour and of the ground's it shows. Then both colours and their contrast, and the width.
    """
    width = width_px[:, None].astype(np.float32)
    off = np.abs(PLACES) * (width + np.float32(BEYOND_PX))
    ground = _mean(colour, off > width / 2 + GROUND_FROM_PX, pieces)
    thread = _mean(colour, off < width * THREAD_SHARE + THREAD_PX, pieces)
    contrast = (np.sqrt(np.square(thread - ground).mean(axis=1)) + LEAST_CONTRAST)[:, None]
    n, t = colour.shape[:2]
    seen = np.empty((n, CHANNELS * t + NUMBERS), np.float32)
    shares = seen[:, : CHANNELS * t].reshape(n, t, CHANNELS)
    weights, offsets = _mixing(thread, ground, contrast)
    np.matmul(colour, weights, out=shares)
    shares += offsets[:, None]
    np.clip(shares, LEAST_SHARE, MOST_SHARE, out=shares)
    of_ground = ground.mean(axis=1, keepdims=True)
    seen[:, CHANNELS * t :] = np.concatenate(
        (
            np.log(width / USUAL_WIDTH_PX),
            np.log(contrast / USUAL_CONTRAST),
            (thread - ground) / contrast,
            ground / (of_ground + LEAST_CONTRAST) - 1,
            of_ground / USUAL_LEVEL - 1,
        ),
        axis=1,
    )
    return seen


def _mixing(
    thread: Float32[np.ndarray, "n 3"], ground: Float32[np.ndarray, "n 3"], contrast: Float32[np.ndarray, "n 1"]
) -> tuple[Float32[np.ndarray, "n 3 k"], Float32[np.ndarray, "n k"]]:
    """Weights of a colour's channels, and what is added, for everything that is told of a place.

    The shares of both colours are those that explain the colour best where both, in an even light, sum to one: as for
    edges.
    """
    even, t, g = 1 / LIGHT**2, thread / COLOUR_NOISE, ground / COLOUR_NOISE
    tt, gg, tg = ((one * other).sum(axis=1, keepdims=True) + even for one, other in ((t, t), (g, g), (t, g)))
    tt, gg = tt + 1, gg + 1
    scale = 1 / (tt * gg - tg**2)
    weights = np.zeros((len(t), 3, CHANNELS), np.float32)
    weights[:, (0, 1, 2), (0, 1, 2)] = 1 / contrast
    weights[:, :, 3] = 1 / (ground.sum(axis=1, keepdims=True) + 3 * LEAST_CONTRAST)
    weights[:, :, 4] = (t * gg - g * tg) * (scale / COLOUR_NOISE)
    weights[:, :, 5] = (g * tt - t * tg) * (scale / COLOUR_NOISE)
    return weights, np.concatenate(
        (-ground / contrast, np.full_like(scale, -1), even * (gg - tg) * scale, even * (tt - tg) * scale), axis=1
    )


def _mean(
    colour: Float32[np.ndarray, "n t 3"], where: Bool[np.ndarray, "n t"], pieces: Pieces
) -> Float32[np.ndarray, "n 3"]:
    """The mean colour of some places of the profiles hereabouts."""
    weight = where.astype(np.float32)
    total = np.concatenate(((weight[:, None] @ colour)[:, 0], weight.sum(axis=1, keepdims=True)), axis=1)
    both = blurred(total, pieces, gaussian(ALONG))
    return both[:, :3] / np.maximum(both[:, 3:], np.float32(LEAST))
