"""What it costs to take two ends of pieces for neighbours on one thread.

For the angles a and b, in the same sense of rotation, between the way across a gap g and the directions of both ends,
the least bent way has ∫κ² = 4 (a² − a b + b²) / g (Hermite's cubic), and a thread is bent by κ₀ anyway; that is how
reconstruction links pieces, too. Here what both pieces look like is added.

Colour and width tell pieces of one thread from pieces of another. Along one thread the light changes, and with it how
bright the thread is; its hue and its width hardly change. On path-traced scenes of several threads, pieces of one
thread differ by about 1.5 in OpenCV's 8-bit a and b, 15 in L and a twelfth in width (standard deviations).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

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


HUE, BRIGHTNESS, WIDTH = 2.5, 24.0, 0.14
"""Standard deviations of the difference of two pieces of one thread: of a and b, of L, and of the width's logarithm."""
SHEEN, GREY = 1.0, 128.0
"""How much paler a thread is by its sheen, for each share of the way to white; a and b of what has no colour."""
SHORT_WIDTHS = 6.0
"""A piece of so many widths is told half as well: what lies beside it and glints colour its few pixels."""
DEAREST_LOOKS = 30.0
"""No piece looks so different that nothing else could speak for it: a shadow may lie on it."""


@dataclass(frozen=True)
class Looks:
    """How each piece looks.

    Fields:
        lab: median of L, a and b (OpenCV's 8-bit numbers) along the middle.
        width_px: median.
        length: in widths.
    """

    lab: Float64[np.ndarray, "p 3"]
    width_px: Float64[np.ndarray, "p"]
    length: Float64[np.ndarray, "p"]


def looks_of(image: UInt8[np.ndarray, "h w 3"], lines: Centrelines, pieces: list[Int64[np.ndarray, "k"]]) -> Looks:
    """How each of these pieces looks, by the points that each has among the centrelines."""
    if not pieces:
        return Looks(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    at = np.rint(lines.point_px).astype(np.intp)
    seen = image[at[:, 1].clip(0, image.shape[0] - 1), at[:, 0].clip(0, image.shape[1] - 1)]
    lab = cv2.cvtColor(seen[None], cv2.COLOR_BGR2Lab)[0].astype(np.float64)
    width = np.array([np.median(lines.width_px[piece]) for piece in pieces])
    return Looks(
        np.array([np.median(lab[piece], axis=0) for piece in pieces]),
        width,
        np.array([len(piece) for piece in pieces]) / width,
    )


def unlikeness(one: Looks, other: Looks) -> Float64[np.ndarray, "p q"]:
    """How unlike pieces look: the square of their difference, in the variances of pieces of one thread."""
    doubt = 1.0 + SHORT_WIDTHS / one.length[:, None] + SHORT_WIDTHS / other.length[None]
    brighter = (one.lab[:, None, 0] - other.lab[None, :, 0]) / BRIGHTNESS
    wider = np.log(one.width_px[:, None] / other.width_px[None]) / WIDTH
    hue = _hue_apart(one.lab, other.lab) / HUE
    return np.minimum((brighter**2 + hue**2 + wider**2) / doubt, DEAREST_LOOKS)


def _hue_apart(one: Float64[np.ndarray, "p 3"], other: Float64[np.ndarray, "q 3"]) -> Float64[np.ndarray, "p q"]:
    """How far apart a and b lie, besides what the sheen of the brighter piece may have taken from its colour.

    A thread mirrors white light, most where it is brightest: there it is paler, in the same hue.
    """
    one, other = np.broadcast_arrays(one[:, None], other[None])
    first = (one[..., :1] > other[..., :1]).repeat(3, axis=2)
    bright, dark = np.where(first, one, other), np.where(first, other, one)
    body, seen = dark[..., 1:] - GREY, bright[..., 1:] - GREY
    palest = 1.0 - np.minimum(SHEEN * (bright[..., 0] - dark[..., 0]) / (255.0 - dark[..., 0] + 1e-9), 1.0)
    share = (body * seen).sum(axis=2) / np.maximum((body**2).sum(axis=2), 1e-9)
    return np.linalg.norm(seen - np.clip(share, palest, 1.0)[..., None] * body, axis=2)
