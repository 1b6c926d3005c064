"""The richest way through pieces of a curve: an exact programme over subsets (Held and Karp 1962).

Every piece on the way earns its prize, every link from one piece to the next costs. Pieces may be left out, so clutter
that nothing leads to stays outside. A piece has two ends, 2p and 2p + 1; whoever enters by one leaves by the other.
"""

import numpy as np
from jaxtyping import Float64, Int64


def richest_way(cost: Float64[np.ndarray, "e e"], prize: Float64[np.ndarray, "p"]) -> list[tuple[int, bool]]:
    """Pieces in order, each with whether it is passed from its first end to its last.

    Args:
        cost: of the link from each end to each other one; infinite where there is none.
        prize: of each piece. Time and memory grow as 2 to the power of their number.
    """
    count, ends = len(prize), 2 * len(prize)
    value = np.full((1 << count, ends), -np.inf)
    before = np.full((1 << count, ends), -1)
    leave = np.arange(ends)
    value[1 << (leave // 2), leave] = prize[leave // 2]
    links = cost[:, leave ^ 1]
    for masks in _subsets_by_size(count)[:-1]:
        known = masks[np.isfinite(value[masks]).any(axis=1)]
        _extend(known, value, before, links, prize)
    mask, end = divmod(int(value.argmax()), ends)
    way: list[tuple[int, bool]] = []
    while True:
        way.append((end // 2, end % 2 == 1))
        state = int(before[mask, end])
        if state < 0:
            return way[::-1]
        mask, end = divmod(state, ends)


def _subsets_by_size(count: int) -> list[Int64[np.ndarray, "k"]]:
    masks = np.arange(1, 1 << count)
    size = ((masks[:, None] >> np.arange(count)) & 1).sum(axis=1)
    return [masks[size == wanted] for wanted in range(1, count + 1)]


def _extend(
    masks: Int64[np.ndarray, "k"],
    value: Float64[np.ndarray, "s e"],
    before: Int64[np.ndarray, "s e"],
    links: Float64[np.ndarray, "e e"],
    prize: Float64[np.ndarray, "p"],
) -> None:
    """Improve the values of all states that are one piece larger than these subsets."""
    if not len(masks):
        return
    leave = np.arange(value.shape[1])
    total = value[masks][:, :, None] - links[None]
    last = total.argmax(axis=1)
    gain = np.take_along_axis(total, last[:, None], axis=1)[:, 0] + prize[leave // 2]
    unvisited = (masks[:, None] >> (leave // 2)) & 1 == 0
    row, end = np.nonzero(unvisited & np.isfinite(gain))
    best = gain[row, end]
    # of several ways into one state the last one assigned stays, so the best comes last
    order = np.argsort(best, kind="stable")
    row, end, best = row[order], end[order], best[order]
    into = masks[row] | (1 << (end // 2))
    value[into, end] = best
    before[into, end] = masks[row] * value.shape[1] + last[row, end]
