"""How far a point of a centreline may lie from the thread's true middle, across it.

The shares below are standard deviations measured against exact truth, over scenes of very different threads; each part
is added in squares. `docs/perception.md` says how well they hold.
"""

import numpy as np
from jaxtyping import Float64, Int64

from agents.perception.centrelines.along import gaussian, places_to_ends, smoothed
from agents.perception.centrelines.refine import Curves, Evidence

GRADED_PX = 0.01
PIXEL_SHARE = 0.05
"""Of a pixel, over the width: coverage does not say where within its border pixels the thread lies."""
SHADING_SHARE = 0.038
"""Of the width: light from one side, shadows and glints shift what looks like an edge."""
DOUBT_SHARE = 0.5
"""Of the distance between the middle of the mask and that of the edges."""
USUAL_SHARE, UNUSUAL_SHARE = 0.15, 0.6
"""Of the usual width: by how much it may vary; and of what it varies more, the share that shifts the middle."""
USUAL_SPAN_PX = 12.0
END_SHARE, CUT_SHARE = 0.02, 0.04
"""Of the width, within a width of a loose end or two of a cut: there the profile also holds what lies beyond."""


def deviations(curves: Curves, seen: Evidence, graded: bool) -> Float64[np.ndarray, "n"]:
    """Standard deviation of each point across the thread, in pixels."""
    width = seen.width_px
    usual = _usual_width(width, curves.piece)
    at_sight = GRADED_PX + PIXEL_SHARE / usual if graded else SHADING_SHARE * usual
    parts = [
        at_sight,
        DOUBT_SHARE * seen.doubt_px,
        UNUSUAL_SHARE * np.maximum(np.abs(width - usual) - USUAL_SHARE * usual, 0),
        END_SHARE * usual * (1 - _closeness(curves, usual, loose=True)),
        CUT_SHARE * usual * (1 - _closeness(curves, 2 * usual, loose=False)),
        np.where(seen.open, 0.5 * usual, 0),
    ]
    return np.sqrt(np.sum([part**2 for part in parts], axis=0))


def _usual_width(width: Float64[np.ndarray, "n"], piece: Int64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """Width of the thread hereabouts, hardly drawn up where strands touch."""
    typical = float(np.median(width))
    clipped = np.clip(width, 0.7 * typical, 1.2 * typical)
    return smoothed(clipped[:, None], piece, gaussian(USUAL_SPAN_PX))[:, 0].clip(0.7 * typical, 1.2 * typical)


def _closeness(curves: Curves, reach: Float64[np.ndarray, "n"], loose: bool) -> Float64[np.ndarray, "n"]:
    """Distance to the piece's nearest end of the kind, as a share of `reach`, 1 at most."""
    before, after = places_to_ends(curves.piece)
    far = len(curves.piece)
    start = np.where(curves.loose_start[curves.piece] == loose, before, far)
    end = np.where(curves.loose_end[curves.piece] == loose, after, far)
    return np.minimum(np.minimum(start, end) / reach, 1.0)
