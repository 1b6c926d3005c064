"""Whether a curve visits the places of the true thread in their order, and how often its picture crosses itself."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

SAMPLES = 400
NEXT_SAMPLES = 6
"""How far along the truth one step of the curve may lead without being a jump: one sample where all is well, more
where the curve cuts a corner."""
JUMP_PRICE = 0.2
"""Of a jump along the truth, as a share of its length: that of ten samples that are 2 % of the length off."""
LARGEST_BACK, LARGEST_SKIP = 0.03, 0.05
"""Of the thread's length: how far a curve in the right order may fall back or leave out."""
LEAST_LOOP = 0.01
"""Of the curve's length: a loop that is shorter is a kink, and no crossing."""


@dataclass(frozen=True)
class Topology:
    """The order of a curve along the true thread, and the crossings of either's picture."""

    in_order: bool
    crossings: int
    true_crossings: int

    @property
    def right(self) -> bool:
        """Whether the order is right and the crossings are as many as they should be."""
        return self.in_order and self.crossings == self.true_crossings


def topology(
    curve: Float64[np.ndarray, "n 3"],
    truth: Float64[np.ndarray, "m 3"],
    curve_px: Float64[np.ndarray, "n 2"],
    truth_px: Float64[np.ndarray, "m 2"],
) -> Topology:
    """Compare the topology of a curve with that of the true thread, both evenly sampled, in whichever direction fits.

    Args:
        curve_px, truth_px: their projections into the left image.
    """
    few, true = evenly(curve, SAMPLES), evenly(truth, SAMPLES)
    return Topology(
        in_order=_in_order(few, true) or _in_order(few[::-1], true),
        crossings=self_crossings(evenly(curve_px, SAMPLES)),
        true_crossings=self_crossings(evenly(truth_px, SAMPLES)),
    )


def _in_order(curve: Float64[np.ndarray, "n 3"], truth: Float64[np.ndarray, "n 3"]) -> bool:
    place = places_along(curve, truth) / (len(truth) - 1)
    ahead = np.maximum.accumulate(place)
    falls_back = float((ahead - place).max())
    reached = np.unique(np.concatenate(([0.0], place, [1.0])))
    return falls_back <= LARGEST_BACK and float(np.diff(reached).max()) <= LARGEST_SKIP


def places_along(curve: Float64[np.ndarray, "n d"], truth: Float64[np.ndarray, "m d"]) -> Int64[np.ndarray, "n"]:
    """For each sample of a curve the sample of the truth that it stands for: the nearest one, without needless jumps.

    The sequence of least summed distance, by dynamic programming: between samples of the curve the place may move by
    a few samples in either direction for nothing, and anywhere at the price of a jump.
    """
    distance = np.linalg.norm(curve[:, None] - truth[None], axis=2)
    price = JUMP_PRICE * float(np.linalg.norm(np.diff(truth, axis=0), axis=1).sum())
    shifts = np.arange(-NEXT_SAMPLES, NEXT_SAMPLES + 1)
    here = np.arange(len(truth))
    before = here[:, None] - shifts
    known = (before >= 0) & (before < len(truth))
    came_from = np.zeros(distance.shape, np.int64)
    cost = distance[0]
    for row in range(1, len(curve)):
        nearby = np.where(known, cost[np.clip(before, 0, len(truth) - 1)], np.inf)
        best = nearby.argmin(axis=1)
        jumped = int(cost.argmin())
        stay = nearby[here, best] <= cost[jumped] + price
        came_from[row] = np.where(stay, before[here, best], jumped)
        cost = distance[row] + np.where(stay, nearby[here, best], cost[jumped] + price)
    place = np.empty(len(curve), np.int64)
    place[-1] = cost.argmin()
    for row in range(len(curve) - 1, 0, -1):
        place[row - 1] = came_from[row, place[row]]
    return place


def self_crossings(px: Float64[np.ndarray, "n 2"]) -> int:
    """How often an evenly sampled polyline in the plane crosses itself, kinks apart."""
    start, along = px[:-1], np.diff(px, axis=0)
    count = len(start)

    def side(of: Float64[np.ndarray, "k 2"]) -> Float64[np.ndarray, "n k"]:
        """On which side of each piece points lie."""
        offset = of[None] - start[:, None]
        return along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]

    splits = (side(px[:-1]) > 0) != (side(px[1:]) > 0)
    i, j = np.nonzero(splits & splits.T)
    return int(np.count_nonzero(j - i > max(1.0, LEAST_LOOP * count)))


def evenly(points: Float64[np.ndarray, "n d"], count: int) -> Float64[np.ndarray, "k d"]:
    """About so many of the points, both ends among them."""
    return points[np.linspace(0, len(points) - 1, count).round().astype(int)]
