"""How pieces of thread look: their colour and width tell pieces of one thread from pieces of another.

Along one thread the light changes, and with it how bright the thread is; its hue and its width hardly change. On
path-traced scenes of several threads, pieces of one thread differ by about 1.5 in OpenCV's 8-bit a and b, 15 in L and a
twelfth in width (standard deviations).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from schemas.messages import Centrelines

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
