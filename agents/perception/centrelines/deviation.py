"""How far a point of a centreline may lie from the thread's true middle, across it.

The shares below are standard deviations measured against exact truth, over scenes of very different threads; each part
is added in squares. `docs/perception.md` says how well they hold.
"""

import numpy as np
from jaxtyping import Bool, Float64

from agents.perception.centrelines.along import REACH, Pieces, directions, gaussian, smoothed
from agents.perception.centrelines.refine import Curves, Evidence, to_ends

GRADED_PX = 0.005
PIXEL_SHARE = 0.05
"""Of a pixel, over the width: coverage does not say where within its border pixels the thread lies."""
ROW_PX, ROW_SLOPE = 0.06, 0.05
"""A thread along the rows or columns meets their borders alike for many pixels, so that the error does not average."""
SHADING_SHARE = 0.038
"""Of the width: shadows and glints shift what looks like an edge."""
DOUBT_SHARE = 0.5
"""Of the distance between the middle of the mask and that of the edges."""
USUAL_SHARE, UNUSUAL_SHARE = 0.15, 0.6
"""Of the usual width: by how much it may vary; and of what it varies more, the share that shifts the middle."""
END_SHARE, CUT_SHARE = 0.02, 0.04
"""Of the width, within a width of a loose end or two of a cut: there the profile also holds what lies beyond."""

BRIDGE_LENGTH, BRIDGE_SHARE = 8.0, 0.15
"""Of the width: how long two strands that cross at a slant may run as one, and how far from each its middle is."""


def deviations(curves: Curves, seen: Evidence, at_sight: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """Standard deviation of each point across the thread, in pixels.

    Args:
        at_sight: that of what the last round saw, by itself.
    """
    width = seen.width_px
    usual = _usual_width(width, curves.pieces)
    parts = [
        at_sight,
        DOUBT_SHARE * seen.aside_px,
        UNUSUAL_SHARE * np.maximum(np.abs(width - usual) - USUAL_SHARE * usual, 0),
        END_SHARE * usual * (1 - np.minimum(to_ends(curves, loose=True) / usual, 1)),
        CUT_SHARE * usual * (1 - np.minimum(to_ends(curves, loose=False) / (2 * usual), 1)),
        np.where(seen.open, 0.5 * usual, 0),
        np.where(_is_bridge(curves, usual), BRIDGE_SHARE * usual, 0),
    ]
    return np.sqrt(sum(part * part for part in parts))


def of_edges(curves: Curves, seen: Evidence) -> Float64[np.ndarray, "n"]:
    """What remains unknown where the edges in the image tell."""
    return SHADING_SHARE * _usual_width(seen.width_px, curves.pieces)


def of_coverage(curves: Curves, seen: Evidence) -> Float64[np.ndarray, "n"]:
    """What remains unknown where nothing but anti-aliased coverage tells."""
    usual = _usual_width(seen.width_px, curves.pieces)
    slope = np.abs(directions(curves.point, curves.pieces, gaussian(2.0))).min(axis=1)
    return np.hypot(GRADED_PX + PIXEL_SHARE / usual, ROW_PX / (1 + (slope / ROW_SLOPE) ** 2))


def _usual_width(width: Float64[np.ndarray, "n"], pieces: Pieces) -> Float64[np.ndarray, "n"]:
    """Width of the thread hereabouts, hardly drawn up where strands touch."""
    typical = np.median(width)
    clipped = np.clip(width, 0.7 * typical, 1.2 * typical)
    span = 2 * REACH + 1
    return smoothed(clipped[:, None], pieces, np.full(span, 1 / span))[:, 0].clip(0.7 * typical, 1.2 * typical)


def _is_bridge(curves: Curves, usual: Float64[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Whether the point lies between two junctions close to each other, where two strands may run as one."""
    pieces = curves.pieces
    between = ~(curves.loose_start | curves.loose_end)[pieces.number]
    return between & (pieces.before + pieces.after < BRIDGE_LENGTH * usual)
