"""Where the thread ends now: it slides, comes out of hiding and goes into it."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.centrelines.along import STRIDE, Pieces, evenly_spaced
from agents.perception.centrelines.profiles import normals, sample
from agents.perception.following.appearance import GROUND_PX, THREAD_SHARES, Colours, share_of_thread
from agents.perception.following.stacked import Eyes

REACH_PX, STEP_PX = 12.0, 0.5
"""How far an end may have moved, either way, from one frame to the next."""
HALF = 0.5
LEAST_SPACING_PX = 0.3
LEAST_CLEAR = 0.2
"""How much more of a strip is thread than of what lies beside it, at least, where a thread goes on."""


@dataclass(frozen=True)
class Ends:
    """How far beyond each end the thread goes on, less than 0 where it ends before; first all starts, then all ends.

    Fields:
        lost: whether it does so farther than an end may move, or is nowhere near.
    """

    reach_px: Float64[np.ndarray, "e"]
    lost: Bool[np.ndarray, "e"]


def ends_of(
    image: UInt8[np.ndarray, "h w 3"],
    point: Float64[np.ndarray, "e 2"],
    outward: Float64[np.ndarray, "e 2"],
    width: float,
    colours: Colours,
    eyes: Eyes,
) -> Ends:
    """Where the thread ends along straight lines through each end, in an image that holds some eyes."""
    at = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    places = (point[None] + at[:, None, None] * outward).reshape(-1, 2)
    across = np.repeat(normals(outward)[None], len(at), axis=0).reshape(-1, 2)
    beyond = width / 2 + GROUND_PX[:2]
    steps = np.concatenate((THREAD_SHARES * width, -beyond, beyond))
    seen = sample(image, places, across, steps, cv2.BORDER_REPLICATE)
    share = share_of_thread(seen, np.tile(colours, (len(at), 1, 1))).reshape(len(steps), len(at), -1)
    own, beside = share[:3].mean(axis=0), share[3:].mean(axis=0)
    own, beside = (np.asarray(cv2.blur(part, (1, 3), borderType=cv2.BORDER_REPLICATE)) for part in (own, beside))
    within = eyes.within(places).reshape(len(at), -1)
    level = np.where(within, np.minimum(own - HALF, own - beside - LEAST_CLEAR), -HALF)
    # as much thread before the end as there can be, and nothing of it after: single places may mislead
    so_far = np.cumsum(level.clip(-LEAST_CLEAR, LEAST_CLEAR), axis=0)
    last, every = np.argmax(so_far, axis=0), np.arange(len(point))
    after = np.minimum(last + 1, len(at) - 1)
    inside, outside = level[last, every], level[after, every]
    share_px = STEP_PX * inside / np.maximum(inside - outside, 1e-6)
    return Ends(at[last] + np.clip(share_px, 0, STEP_PX), (so_far[last, every] <= 0) | (last == len(at) - 1))


def with_ends(
    point: Float64[np.ndarray, "n 2"],
    pieces: Pieces,
    outward: Float64[np.ndarray, "e 2"],
    reach_px: Float64[np.ndarray, "e"],
) -> tuple[Float64[np.ndarray, "m 2"], Pieces]:
    """Pieces, with points a pixel apart, that end where the thread does."""
    count = len(pieces.first)
    parts: list[Float64[np.ndarray, "k 2"]] = []
    lengths: list[int] = []
    for k, (a, b) in enumerate(zip(pieces.first.tolist(), pieces.last.tolist(), strict=True)):
        turned = _before(point[a : b + 1][::-1], outward[k], reach_px[k])
        part = _before(turned[::-1], outward[count + k], reach_px[count + k]) if len(turned) else turned
        tips = point[a] + reach_px[k] * outward[k], point[b] + reach_px[count + k] * outward[count + k]
        parts += [tips[0][None], part, tips[1][None]]
        lengths.append(len(part) + 2)
    return evenly_spaced(np.concatenate(parts), Pieces(np.repeat(np.arange(count), lengths)), 1.0)


def _before(
    part: Float64[np.ndarray, "k 2"], outward: Float64[np.ndarray, "2"], reach_px: float
) -> Float64[np.ndarray, "j 2"]:
    """Points without the last ones that lie beyond where the thread ends, or hardly before it."""
    last = part[-round(2 * REACH_PX / STRIDE) :]
    inside = np.flatnonzero((last - part[-1]) @ outward < reach_px - LEAST_SPACING_PX)
    return part[: len(part) - len(last) + (int(inside[-1]) + 1 if len(inside) else 0)]
