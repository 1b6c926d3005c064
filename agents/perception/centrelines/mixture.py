"""How much of a colour is thread and how much is ground: the share hardly depends on light.

Shading and glints make the brightness across a round thread lopsided, and a shadow lies beside it. So what a place
shows is taken to be a mixture c = a t + b g of the thread's own colour t thereabouts and the ground's g. Light and
shadow change a and b alike, so that the share a / (a + b) of thread hardly depends on them where thread and ground
differ in colour. Where they do not, a and b cannot be told apart by colour, and then they sum to 1:

    min over a, b of ‖c − a t − b g‖² / COLOUR_NOISE² + (a + b − 1)² / LIGHT².

Both are linear in the colour that is seen.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32

from agents.perception.centrelines.along import Pieces, blurred, gaussian

COLOUR_NOISE, LIGHT = 5.0, 0.15
"""Standard deviations of a colour, in grey levels, and of how bright thread and ground are."""
LEAST, LEAST_PLACES = np.float32(1e-6), np.float32(1e-3)


def mean_colour(
    channels: Float32[np.ndarray, "3 t n"], where: Bool[np.ndarray, "t n"], pieces: Pieces, along: float
) -> Float32[np.ndarray, "3 n"]:
    """The mean colour at some places of profiles, and of those beside, by a Gaussian of so many points."""
    rows = np.flatnonzero(where.any(axis=1))
    some = slice(rows[0], rows[-1] + 1) if len(rows) else slice(0)
    total = (channels[:, some] * where[some]).sum(axis=1), where[some].sum(axis=0, dtype=np.float32)[None]
    both = blurred(np.concatenate(total), pieces, gaussian(along))
    return both[:3] / np.maximum(both[3], LEAST_PLACES)


def mixture_weights(
    thread: Float[np.ndarray, "3 n"], ground: Float[np.ndarray, "3 n"]
) -> tuple[Float32[np.ndarray, "4 n"], Float32[np.ndarray, "4 n"]]:
    """By what a colour's channels count for the amounts of thread and of ground in it, and what is added to either."""
    even, t, g = 1 / LIGHT**2, thread / COLOUR_NOISE, ground / COLOUR_NOISE
    tt, gg, tg = ((one * other).sum(axis=0) + even for one, other in ((t, t), (g, g), (t, g)))
    # without the ones, colours that are the same would have no solution
    tt, gg = tt + 1, gg + 1
    scale = 1 / (tt * gg - tg**2)
    of_thread = (t * gg - g * tg) * (scale / COLOUR_NOISE), (even * (gg - tg) * scale)[None]
    of_ground = (g * tt - t * tg) * (scale / COLOUR_NOISE), (even * (tt - tg) * scale)[None]
    return np.concatenate(of_thread, dtype=np.float32), np.concatenate(of_ground, dtype=np.float32)


def weighted(channels: Float32[np.ndarray, "3 t n"], weights: Float32[np.ndarray, "4 n"]) -> Float32[np.ndarray, "t n"]:
    """The sum of the weighted channels and of what is added."""
    blue, green, red = channels
    return blue * weights[0] + weights[3] + green * weights[1] + red * weights[2]


def share_of_mixture(
    channels: Float32[np.ndarray, "3 t n"], thread: Float[np.ndarray, "3 n"], ground: Float[np.ndarray, "3 n"]
) -> Float32[np.ndarray, "t n"]:
    """The share of thread, 0 to 1; neither counts for less than nothing."""
    of_thread, of_ground = (
        np.maximum(weighted(channels, weights), np.float32(0)) for weights in mixture_weights(thread, ground)
    )
    return of_thread / np.maximum(of_thread + of_ground, LEAST)
