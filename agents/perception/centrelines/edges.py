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
ALONG = 2.0
"""Standard deviation, in points that lie four pixels apart, of the average along the thread in which its colour and the
ground's are seen."""
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
    seen: Float32[np.ndarray, "3 t n"], at: Float64[np.ndarray, "t"], width_px: Float64[np.ndarray, "n"], pieces: Pieces
) -> Edges:
    """Both edges on profiles of the image, looked for where the mask ends.

    Args:
        seen: at every fourth point of a curve.
        at: where the profiles are seen, from the middle of the mask.
        width_px: of the mask.
    """
    gradient = _gradient(share_of_thread(seen, at, width_px, pieces))
    energy = gradient * gradient
    rising, falling = energy * (gradient > 0), energy * (gradient < 0)
    return Edges(_settled(rising, at, -width_px / 2), _settled(falling, at, width_px / 2))


def _gradient(share: Float32[np.ndarray, "t n"]) -> Float32[np.ndarray, "t n"]:
    """By the places on either side; at the ends, where no edge is looked for, it is 0."""
    gradient = np.zeros_like(share)
    gradient[1:-1] = np.float32(0.5) * (share[2:] - share[:-2])
    return gradient


def share_of_thread(
    seen: Float32[np.ndarray, "3 t n"], at: Float64[np.ndarray, "t"], width_px: Float64[np.ndarray, "n"], pieces: Pieces
) -> Float32[np.ndarray, "t n"]:
    """How much of each place on profiles of the image is thread, from 0 to 1, by its colour."""
    half = np.maximum(1.0, width_px) / 2
    place = at[:, None]
    places = np.abs(place) <= half / 2 + 0.25, place < -half - GAP_PX, place > half + GAP_PX
    thread, near, far = _colours(seen, places, pieces)
    middle = int(np.searchsorted(at, 0.0))
    sides = (seen[:, :middle], near), (seen[:, middle:], far)
    return np.concatenate([_share(part, thread, ground) for part, ground in sides])


def _colours(
    seen: Float32[np.ndarray, "3 t n"], where: tuple[Bool[np.ndarray, "t n"], ...], pieces: Pieces
) -> Float64[np.ndarray, "k 3 n"]:
    """The mean colours at some places of the profiles hereabouts."""
    parts = [part for places in where for part in (*_totals(seen, places), places.sum(axis=0, dtype=np.float32))]
    both = blurred(np.stack(parts), pieces, gaussian(ALONG)).astype(np.float64).reshape(len(where), 4, -1)
    return both[:, :3] / np.maximum(both[:, 3:], LEAST)


def _totals(seen: Float32[np.ndarray, "3 t n"], places: Bool[np.ndarray, "t n"]) -> Float32[np.ndarray, "3 n"]:
    """The sums of the colours at some places; rows that have none of them are left out."""
    rows = np.flatnonzero(places.any(axis=1))
    some = slice(rows[0], rows[-1] + 1) if len(rows) else slice(0)
    return (seen[:, some] * places[some]).sum(axis=1)


def _share(
    seen: Float32[np.ndarray, "3 t n"], thread: Float64[np.ndarray, "3 n"], ground: Float64[np.ndarray, "3 n"]
) -> Float32[np.ndarray, "t n"]:
    """The share of thread in mixtures of it with the ground: a and b are linear in the colour that is seen."""
    even, t, g = 1 / LIGHT**2, thread / COLOUR_NOISE, ground / COLOUR_NOISE
    tt, gg, tg = ((one * other).sum(axis=0) + even for one, other in ((t, t), (g, g), (t, g)))
    # without the ones, colours that are the same would have no solution
    tt, gg = tt + 1, gg + 1
    scale = 1 / (tt * gg - tg**2)
    of_thread = _positive(seen, t * (gg * scale) - g * (tg * scale), even * (gg - tg) * scale)
    of_ground = _positive(seen, g * (tt * scale) - t * (tg * scale), even * (tt - tg) * scale)
    return of_thread / np.maximum(of_thread + of_ground, np.float32(LEAST))


def _positive(
    seen: Float32[np.ndarray, "3 t n"], weight: Float64[np.ndarray, "3 n"], level: Float64[np.ndarray, "n"]
) -> Float32[np.ndarray, "t n"]:
    """What is above 0 of a weighted sum of the channels."""
    blue, green, red = (weight / COLOUR_NOISE).astype(np.float32)
    total = seen[0] * blue + level.astype(np.float32) + seen[1] * green + seen[2] * red
    return np.maximum(total, np.float32(0))


def _settled(
    energy: Float32[np.ndarray, "t n"], at: Float64[np.ndarray, "t"], start: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n"]:
    edge, steps = start, at.astype(np.float32)
    places = steps[:, None] * np.float32(1 / REACH_PX)
    for _ in range(ROUNDS):
        distance = places - (edge / REACH_PX).astype(np.float32)
        weight = np.maximum(1 - distance * distance, 0)
        weight *= weight
        weight *= energy
        total = weight.sum(axis=0, dtype=np.float64)
        edge = (steps @ weight + WEAK * start) / (total + WEAK)
    return np.clip(edge, start - REACH_PX, start + REACH_PX)
