"""The thread's two edges in the image itself, for masks that say which pixels are thread but not how much of each.

Shading and glints make the brightness across a round thread lopsided, and a shadow lies beside it, so neither centroids
nor edges of brightness are of use. What each profile shows is therefore taken to be a mixture c = a t + b g of the
thread's own colour t thereabouts and the ground's g on that side. Light and shadow change a and b alike, so that the
share a / (a + b) of thread hardly depends on them where thread and ground differ in colour. Where they do not, a and b
cannot be told apart by colour, and then they sum to 1:

    min over a, b of ‖c − a t − b g‖² / COLOUR_NOISE² + (a + b − 1)² / LIGHT².

An edge is the centre of squared gradients of the right sign of that share, near the mask's border.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64

from agents.perception.centrelines.along import Pieces, blurred, gaussian

COLOUR_NOISE, LIGHT = 5.0, 0.15
"""Standard deviations of a colour, in grey levels, and of how bright thread and ground are."""
GAP_PX = 2.0
"""The ground is what lies farther than that from the mask."""
ALONG_PX = 8.0
"""Standard deviation of the average along the thread in which its colour and the ground's are seen."""
REACH_PX = 3.5
"""How far from where it was looked for an edge may draw, with a weight that falls to zero there."""
ROUNDS = 3
WEAK = 1e-4
"""Of a square of shares; an edge of less stays where the mask puts it."""
LEAST = 1e-6


@dataclass(frozen=True)
class Edges:
    """Where the thread begins and ends on each profile, in pixels from the curve along the normal."""

    near_px: Float64[np.ndarray, "n"]
    far_px: Float64[np.ndarray, "n"]


def find_edges(
    seen: Float32[np.ndarray, "n t 3"], at: Float64[np.ndarray, "t"], width_px: Float64[np.ndarray, "n"], pieces: Pieces
) -> Edges:
    """Both edges on profiles of the image, looked for where the mask ends.

    Args:
        at: where the profiles are seen, from the middle of the mask.
        width_px: of the mask.
    """
    gradient = np.gradient(share_of_thread(seen, at, width_px, pieces), axis=1)
    rising, falling = np.maximum(gradient, 0) ** 2, np.maximum(-gradient, 0) ** 2
    return Edges(_settled(rising, at, -width_px / 2), _settled(falling, at, width_px / 2))


def share_of_thread(
    seen: Float32[np.ndarray, "n t 3"], at: Float64[np.ndarray, "t"], width_px: Float64[np.ndarray, "n"], pieces: Pieces
) -> Float32[np.ndarray, "n t"]:
    """How much of each place on profiles of the image is thread, from 0 to 1, by its colour."""
    half = np.maximum(1.0, width_px)[:, None] / 2
    places = np.abs(at) <= half / 2 + 0.25, at < -half - GAP_PX, at > half + GAP_PX
    thread, near, far = _colours(seen, places, pieces)
    channels = np.ascontiguousarray(seen.transpose(2, 0, 1))
    middle = int(np.searchsorted(at, 0.0))
    sides = (channels[:, :, :middle], near), (channels[:, :, middle:], far)
    return np.concatenate([_share(part, thread, ground) for part, ground in sides], axis=1)


def _colours(
    seen: Float32[np.ndarray, "n t 3"], where: tuple[Bool[np.ndarray, "n t"], ...], pieces: Pieces
) -> Float64[np.ndarray, "k n 3"]:
    """The mean colours at some places of the profiles hereabouts."""
    weight = np.stack(where, axis=1).astype(np.float32)
    total = (weight @ seen).reshape(len(seen), -1)
    both = blurred(np.concatenate((total, weight.sum(axis=2)), axis=1), pieces, gaussian(ALONG_PX)).astype(np.float64)
    colour = both[:, : total.shape[1]].reshape(len(seen), -1, 3) / np.maximum(both[:, total.shape[1] :, None], LEAST)
    return colour.transpose(1, 0, 2)


def _share(
    seen: Float32[np.ndarray, "3 n t"], thread: Float64[np.ndarray, "n 3"], ground: Float64[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n t"]:
    """The share of thread in mixtures of it with the ground: a and b are linear in the colour that is seen."""
    even, t, g = 1 / LIGHT**2, thread / COLOUR_NOISE, ground / COLOUR_NOISE
    tt, gg, tg = ((one * other).sum(axis=1) + even for one, other in ((t, t), (g, g), (t, g)))
    # without the ones, colours that are the same would have no solution
    tt, gg = tt + 1, gg + 1
    scale = 1 / (tt * gg - tg**2)
    of_thread = _positive(seen, t * (gg * scale)[:, None] - g * (tg * scale)[:, None], even * (gg - tg) * scale)
    of_ground = _positive(seen, g * (tt * scale)[:, None] - t * (tg * scale)[:, None], even * (tt - tg) * scale)
    return of_thread / np.maximum(of_thread + of_ground, np.float32(LEAST))


def _positive(
    seen: Float32[np.ndarray, "3 n t"], weight: Float64[np.ndarray, "n 3"], level: Float64[np.ndarray, "n"]
) -> Float32[np.ndarray, "n t"]:
    """What is above 0 of a weighted sum of the channels."""
    columns = (weight / COLOUR_NOISE).astype(np.float32).T[:, :, None]
    total = seen[0] * columns[0] + level.astype(np.float32)[:, None]
    for channel, column in zip(seen[1:], columns[1:], strict=True):
        total += channel * column
    return np.maximum(total, np.float32(0))


def _settled(
    energy: Float32[np.ndarray, "n t"], at: Float64[np.ndarray, "t"], start: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n"]:
    edge, steps = start, at.astype(np.float32)
    for _ in range(ROUNDS):
        distance = (steps - edge.astype(np.float32)[:, None]) * np.float32(1 / REACH_PX)
        weight = np.square(np.maximum(1 - distance * distance, 0)) * energy
        total = weight.sum(axis=1, dtype=np.float64)
        edge = (weight @ steps + WEAK * start) / (total + WEAK)
    return np.clip(edge, start - REACH_PX, start + REACH_PX)
