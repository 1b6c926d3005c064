"""How wide the strand is along its centreline: a needle is several times as wide as the thread that hangs on it."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from agents.perception.centrelines.profiles import sample
from agents.perception.centrelines.refine import Curves

WIDE_SHARE = 1.5
"""Of the usual width: what is wider may be something else than thread."""
LEAST_LENGTH = 8.0
"""Of the usual width: how long it must be so wide; where strands cross or touch, the mask is wide for less."""


def local_widths(
    curves: Curves, depth: Float32[np.ndarray, "h w"], width: float
) -> tuple[Float64[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """How wide the strand is at most at each point, and whether it is something wider than thread, as a needle.

    Args:
        curves: in the middle of the strand, points a pixel apart.
        depth: distance of each pixel of the mask to the nearest pixel outside.
        width: of the thread in general, up to two pixels more than it has.
    """
    # the distance counts to the nearest pixel outside, not to the edge before it
    here = 2.0 * sample(depth, curves.point, np.zeros_like(curves.point), np.zeros(1))[:, 0].astype(np.float64) - 1.0
    usual = max(1.0, width - 2.0)
    wide = np.zeros(len(here), bool)
    for k in np.flatnonzero(np.maximum.reduceat(here, curves.pieces.first) > WIDE_SHARE * usual).tolist():
        piece = np.s_[curves.pieces.first[k] : curves.pieces.last[k] + 1]
        wide[piece] = _lasting(here[piece] > WIDE_SHARE * usual, round(LEAST_LENGTH * usual) | 1)
    return np.maximum(width, np.where(wide, here + 2.0, width)), wide


def _lasting(over: Bool[np.ndarray, "n"], span: int) -> Bool[np.ndarray, "n"]:
    """Runs of at least so many points, with what lies beside them: there the middle goes over from one to the other."""
    line, beside = np.ones((1, span), np.uint8), np.ones((1, span // 4 | 1), np.uint8)
    closed = cv2.morphologyEx(over[None].astype(np.uint8), cv2.MORPH_CLOSE, beside)
    return np.asarray(cv2.dilate(cv2.morphologyEx(closed, cv2.MORPH_OPEN, line), beside))[0] > 0
