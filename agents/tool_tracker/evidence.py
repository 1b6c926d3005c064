"""What an image says of an instrument: how much each pixel looks like one, and where its outline runs.

How often each colour comes within an instrument and elsewhere is learnt from the images themselves, by histograms of
colour. Begun is with what is known before anything was found: where the instrument probably is, w, and that instruments
are greyer than tissue, which is red (q = (r - (g + b) / 2) / (luminance + 15) against its median over the image). With
p the share of a pixel that is instrument, and H the histograms of p and of 1 - p, p ∝ w H₁ / (w H₁ + (1 - w) H₀) is
repeated a few times (expectation maximisation, as Rother et al. 2004 cut out objects with). A pixel's likeness is then
H₁ / (H₁ + H₀) of its colour.

Along the normal of an expected outline the edge is where mean likeness inside and outside differ most. Colour mixes
linearly where a pixel is shared between both sides, so the edge is then placed to a part of a pixel where the profile,
projected onto the difference of the mean colours of both sides, crosses one half.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from scipy.ndimage import gaussian_filter

from agents.tool_tracker.outline import Outline

SIDE = 5
"""Samples on either side of an edge that are compared."""
GAP = 1
LEAST_CONTRAST = 0.3
DARK = 15.0
GREY, RED = 0.1, 0.35
BINS, BIN_BITS = 16, 4
SHRINK = 4
ROUNDS = 4

Table = Float32[np.ndarray, "b b b"]


@dataclass(frozen=True, eq=False)
class Eye:
    """One eye's image for looking: colours, and how much each pixel looks like an instrument (0 to 1)."""

    bgr: Float32[np.ndarray, "h w 3"]
    likeness: Float32[np.ndarray, "h w"]


def softened(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """An image with less noise."""
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def eye(soft: UInt8[np.ndarray, "h w 3"], table: Table) -> Eye:
    """A softened image, made ready with what was learnt."""
    return Eye(soft.astype(np.float32), likeness(soft, table))


def likeness(soft: UInt8[np.ndarray, "h w 3"], table: Table) -> Float32[np.ndarray, "h w"]:
    """How much each pixel looks like an instrument."""
    index = np.right_shift(soft.astype(np.int32), BIN_BITS)
    flat = (index[..., 0] * BINS + index[..., 1]) * BINS + index[..., 2]
    return table.ravel()[flat]


def learnt(
    soft: tuple[UInt8[np.ndarray, "h w 3"], ...], within: tuple[Float32[np.ndarray, "k l"], ...], grey: bool
) -> Table:
    """The share of instrument in each colour.

    Args:
        within: at 1 / SHRINK of the size, how probably each pixel is within an instrument.
        grey: whether to begin with that instruments are grey; else `within` is trusted.
    """
    size = within[0].shape[::-1]
    small = [cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in soft]
    colour = np.concatenate([one.reshape(-1, 3) for one in small])
    w = np.clip(np.concatenate([one.ravel() for one in within]).astype(np.float64), 0.002, 0.998)
    p = w * _greyness(colour) if grey else w
    index = np.right_shift(colour.astype(np.int64), BIN_BITS)
    flat = (index[:, 0] * BINS + index[:, 1]) * BINS + index[:, 2]
    ratio = np.full((BINS,) * 3, 0.5)
    for _ in range(ROUNDS):
        tool, rest = (_histogram(flat, share) for share in (p, 1 - p))
        ratio = tool / (tool + rest)
        seen = ratio.ravel()[flat]
        p = w * seen / (w * seen + (1 - w) * (1 - seen))
    return ratio.astype(np.float32)


def _histogram(flat: np.ndarray, share: np.ndarray) -> Float64[np.ndarray, "b b b"]:
    """How often each colour comes, smoothed, and never nought: a colour that was never seen says nothing."""
    counts = np.bincount(flat, weights=share, minlength=BINS**3).reshape((BINS,) * 3)
    smooth = gaussian_filter(counts, 0.7)
    return smooth / max(float(smooth.sum()), 1e-9) + 2e-6


def _greyness(colour: UInt8[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
    blue, green, red = colour.astype(np.float64).T
    q = (red - 0.5 * (green + blue)) / (0.114 * blue + 0.587 * green + 0.299 * red + DARK)
    usual = float(np.median(q))
    # where tissue itself is nearly grey, greyness tells nothing
    tells = float(np.clip((usual - GREY) / (RED - GREY), 0.0, 1.0))
    return 1.0 - tells * np.clip(q / max(usual, GREY), 0.0, 0.98)


@dataclass(frozen=True, eq=False)
class Edges:
    """What was found along normals: the signed distance outward in pixels, and the contrast (0: nothing found)."""

    distance: Float64[np.ndarray, "n"]
    contrast: Float64[np.ndarray, "n"]


def edges(image: Eye, expected: Outline, reach_px: float, spread_px: float) -> Edges:
    """The edge on each normal, within reach; of several the one of most contrast, those farther out counting less.

    Args:
        spread_px: how far (one deviation) the outline is believed to be from where it is expected.
    """
    reach = round(reach_px)
    n = np.arange(-reach - SIDE - GAP, reach + SIDE + GAP + 1, dtype=np.float64)
    at = (expected.px[:, None] + n[None, :, None] * expected.normal[:, None]).astype(np.float32)
    size = image.likeness.shape
    if not len(at):
        return Edges(np.zeros(0), np.zeros(0))
    like = cv2.remap(image.likeness, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # pyright: ignore[reportCallIssue, reportArgumentType]
    sums = np.cumsum(np.pad(like.astype(np.float64), ((0, 0), (1, 0))), axis=1)
    middle = np.arange(SIDE + GAP, len(n) - SIDE - GAP)
    inside = (sums[:, middle - GAP] - sums[:, middle - GAP - SIDE]) / SIDE
    outside = (sums[:, middle + GAP + SIDE + 1] - sums[:, middle + GAP + 1]) / SIDE
    within = np.asarray(((at >= 0) & (at < (size[1] - 1, size[0] - 1))).all(axis=2))
    whole = within[:, middle - GAP - SIDE] & within[:, middle + GAP + SIDE]
    contrast = np.where(whole, inside - outside, 0.0)
    weighed = contrast * np.exp(-0.5 * (n[middle] / max(2 * spread_px, 3.0)) ** 2)
    best = np.argmax(weighed, axis=1)
    rows = np.arange(len(at))
    found = contrast[rows, best]
    found[found < LEAST_CONTRAST] = 0.0
    return Edges(n[middle][best] + _within_pixel(image, at, middle[best]), found)


def _within_pixel(image: Eye, at: Float32[np.ndarray, "n k 2"], index: np.ndarray) -> Float64[np.ndarray, "n"]:
    """Where colour is half way between both sides, from the sample of that index."""
    columns = index[:, None] + np.arange(-SIDE - GAP, SIDE + GAP + 1)
    near = np.take_along_axis(at, columns[..., None], axis=1)
    colour = cv2.remap(image.bgr, near, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)  # pyright: ignore[reportCallIssue, reportArgumentType]
    inside, outside = colour[:, :3].mean(axis=1), colour[:, -3:].mean(axis=1)
    way = outside - inside
    share = np.einsum("nkc,nc->nk", colour - inside[:, None], way) / np.maximum((way**2).sum(axis=1), 1.0)[:, None]
    # half the sum of what is outside is where a step of that height lies
    beyond = np.clip(share, 0.0, 1.0).sum(axis=1)
    middle = SIDE + GAP
    return np.clip((2 * middle + 1) - beyond - 0.5 - middle, -2.5, 2.5)
