"""How sure the pixel matches of the paper's method are, as Rerun shows it.

world/left/match_cost       the matched pixels in the left image: green where the best match costs far less than the
                            second-best, red where both cost alike, so that the other may be the true one
match/cost/best, second     medians over the matched pixels of a frame
match/kept                  the share of matched pixels that is kept
match/histogram/best        how many matched pixels have a best match of which cost
match/histogram/second      the same of the second-best

Methods that match no pixels leave these empty.
"""

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float64

from agents.viewer import colours
from agents.viewer.entity import HALF_PX, Entity
from schemas.messages import ThreadObservations

MOST_SHOWN = 3000
BINS = 40
FAR = 4.0
"""Where the histogram ends, as a multiple of the median of the second-best costs: a few cost a thousand times more."""


def match_entities(observations: ThreadObservations) -> list[Entity]:
    """Match costs in the image, over time and as a histogram."""
    cost, kept = observations.match_cost, observations.inlier
    some = slice(None, None, 1 + len(cost) // MOST_SHOWN)
    at = rr.Points2D(
        observations.matched_px[some, :2] + HALF_PX,
        colors=colours.confidence_rgb(distinctness(cost[some])),
        radii=[-1.5],
    )
    medians = [_median(cost[:, column]) for column in (0, 1)]
    return [
        ("world/left/match_cost", [at]),
        ("match/cost/best", [rr.Scalars(medians[0])]),
        ("match/cost/second", [rr.Scalars(medians[1])]),
        ("match/kept", [rr.Scalars(float(kept.mean()) if len(kept) else np.nan)]),
        *_histograms(cost),
    ]


def distinctness(cost: Float64[np.ndarray, "p 2"]) -> Float64[np.ndarray, "p"]:
    """How much less the best match costs than the second-best, as a share of that: 0 alike, 1 free; NaN unknown."""
    best, second = cost.T
    with np.errstate(all="ignore"):
        share = 1.0 - best / second
    # a second-best that was never found costs infinitely much
    return np.clip(np.where(np.isinf(second) & np.isfinite(best), 1.0, share), 0.0, 1.0)


def _histograms(cost: Float64[np.ndarray, "p 2"]) -> list[Entity]:
    finite: Bool[np.ndarray, "p 2"] = np.isfinite(cost)
    last = FAR * float(np.median(cost[finite[:, 1], 1])) if finite[:, 1].any() else 0.0
    edges = np.linspace(0.0, last if last > 0 else 1.0, BINS + 1)
    middles, widths = 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    return [
        (
            f"match/histogram/{name}",
            [
                rr.BarChart(
                    np.histogram(cost[finite[:, column], column], edges)[0].astype(np.float64),
                    abscissa=middles,
                    widths=widths.astype(np.float32),
                    color=rgb,
                )
            ],
        )
        for column, (name, rgb) in enumerate((("best", colours.GOOD), ("second", colours.REJECTED)))
    ]


def _median(values: Float64[np.ndarray, "p"]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan
