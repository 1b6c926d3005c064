"""What it costs to take two ends of pieces for neighbours on one thread.

For the angles a and b, in the same sense of rotation, between the way across a gap g and the directions of both ends,
the least bent way has ∫κ² = 4 (a² − a b + b²) / g (Hermite's cubic), and a thread is bent by κ₀ anyway; that is how
reconstruction links pieces, too. Here what both pieces look like is added.
"""

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import Centrelines

TANGENT_WIDTHS = 3.0
"""Over so much of a piece the direction of its end is measured."""
ANGLE_DEVIATION = 0.2
"""Of the direction of an end, in radians."""
BENT_PX = 1 / 250
"""How bent a thread is anyway, per pixel."""
GAP_SHARE = 0.03
"""Of the image's width: a gap as long as this costs 1."""
DEAREST_LINK = 16.0


def end_costs(
    lines: Centrelines,
    pieces: list[Int64[np.ndarray, "k"]],
    unlike: Float64[np.ndarray, "p p"],
    image_width: int,
) -> Float64[np.ndarray, "e e"]:
    """The cost of going from end to end; end 2p is the first and 2p + 1 the last of piece p. Infinite: never.

    Args:
        unlike: how unlike the pieces look.
    """
    ends = lines.point_px[[end for piece in pieces for end in (piece[0], piece[-1])]]
    reach = TANGENT_WIDTHS * float(np.median(lines.width_px))
    outward = np.array([_outward(lines.point_px[way], reach) for piece in pieces for way in (piece, piece[::-1])])
    across = ends[None] - ends[:, None]
    gap = np.hypot(across[..., 0], across[..., 1])
    here, there = np.broadcast_to(outward[:, None], across.shape), np.broadcast_to(-outward[None], across.shape)
    # over less than some widths the way across has no direction of its own, and the ends share the turn
    own = np.clip(gap / (2 * reach), 0.0, 1.0)[..., None]
    middle = here + there
    middle = middle / np.maximum(np.linalg.norm(middle, axis=2, keepdims=True), 1e-9)
    way = own * across / np.maximum(gap, 1e-9)[..., None] + (1 - own) * middle
    a, b = _angle(here, way), _angle(way, there)
    cost = (a * a - a * b + b * b) / (ANGLE_DEVIATION**2 + (0.5 * BENT_PX * gap) ** 2)
    cost += gap / (GAP_SHARE * image_width) + np.repeat(np.repeat(unlike, 2, axis=0), 2, axis=1)
    # beside each other rather than after each other
    cost[(gap > reach) & (((across * here).sum(axis=2) < 0) | ((across * there).sum(axis=2) < 0))] = np.inf
    own_piece = np.arange(len(ends)) // 2
    cost[own_piece[:, None] == own_piece[None]] = np.inf
    return np.where(cost <= DEAREST_LINK, cost, np.inf)


def linked(cost: Float64[np.ndarray, "e e"]) -> Int64[np.ndarray, "e"]:
    """The end that follows each end, −1 for none: the cheapest link first, no end twice, and no thread closed."""
    follows = np.full(len(cost), -1)
    thread = np.arange(len(cost)) // 2
    one, other = np.nonzero(np.triu(np.isfinite(cost)))
    for k in np.argsort(cost[one, other], kind="stable"):
        i, j = one[k], other[k]
        if follows[i] < 0 and follows[j] < 0 and thread[i] != thread[j]:
            follows[i], follows[j] = j, i
            thread[thread == thread[j]] = thread[i]
    return follows


def ways(follows: Int64[np.ndarray, "e"]) -> list[list[tuple[int, bool]]]:
    """Pieces in order along each thread, and whether each is passed forward."""
    passed = np.zeros(len(follows) // 2, bool)
    found: list[list[tuple[int, bool]]] = []
    for start in np.flatnonzero(follows < 0).tolist():
        if passed[start // 2]:
            continue
        way: list[tuple[int, bool]] = []
        end = start
        while end >= 0:
            passed[end // 2] = True
            way.append((end // 2, end % 2 == 0))
            end = int(follows[end ^ 1])
        found.append(way)
    return found


def _outward(points: Float64[np.ndarray, "n 2"], reach: float) -> Float64[np.ndarray, "2"]:
    """Outward at the first of these points, which lie about a pixel apart."""
    near = points[: max(3, round(reach) + 1)]
    t = np.linspace(-0.5, 0.5, len(near))
    slope = -(t[:, None] * (near - near.mean(axis=0))).sum(axis=0)
    return slope / max(float(np.linalg.norm(slope)), 1e-9)


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1))
