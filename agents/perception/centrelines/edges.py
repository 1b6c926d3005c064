"""The thread's two edges in the image itself, for masks that say which pixels are thread but not how much of each.

Neither centroids nor edges of brightness are of use for a round thread in light from beside, but the share of thread in
each place by its colour is (`mixture`), with the ground's colour on that side.

An edge is the centre of squared gradients of the right sign of that share, near the mask's border.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from agents.perception.centrelines.along import Pieces
from agents.perception.centrelines.mixture import mean_colour, share_of_mixture

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
    thread, near, far = (mean_colour(seen, each, pieces, ALONG).astype(np.float64) for each in places)
    middle = int(np.searchsorted(at, 0.0))
    sides = (seen[:, :middle], near), (seen[:, middle:], far)
    return np.concatenate([share_of_mixture(part, thread, ground) for part, ground in sides])


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
