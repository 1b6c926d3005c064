"""Places of a thread that the disparity beside them tells, where no row does: along the rows, and among other strands.

Along a thread the disparity changes slowly. So from places that are the same for certain it goes on, and says about
where the right eye sees a place that its row does not tell. That is the place of the right line nearest to it, of all
that lie about there: where the line crosses the rows, its row counts for most, and where it runs along them, the
disparity. Some pixels along the thread are of no account: what light does to its middle changes as slowly.
"""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from agents.perception.centrelines.along import Pieces

ROW_PX, DISPARITY_PX = 0.3, 3.0
"""By how much rows of one place differ, and disparities from what those beside them tell: standard deviations."""
ACROSS_PX, ALONG_PX = 3.0, 8.0
"""So far from where it is to be, across and along itself, the right line may lie."""
LEAST = 1e-9


def expected_px(
    certain: Int64[np.ndarray, "k"],
    disparity_px: Float64[np.ndarray, "k"],
    sample: Int64[np.ndarray, "c"],
    piece: Int64[np.ndarray, "n"],
    reach: float = np.inf,
) -> Float64[np.ndarray, "c"]:
    """The disparity of the nearest certain places of the same piece, between them; infinite where none is near.

    Args:
        certain: numbers of samples, in order; sample: those that are asked about.
        piece: of every sample.
        reach: of a certain place, in samples.
    """
    after = np.searchsorted(certain, sample)
    beside = np.stack((np.maximum(after - 1, 0), np.minimum(after, len(certain) - 1)))
    there = certain[beside]
    away = np.abs(sample - there)
    near = (away <= reach) & (piece[there] == piece[sample])
    weight = near / np.maximum(away, 1)
    total = weight.sum(axis=0)
    mean = (weight * disparity_px[beside]).sum(axis=0) / np.maximum(total, LEAST)
    return np.where(total > 0, mean, np.inf)


def carried_on(
    point_px: Float64[np.ndarray, "n 2"],
    piece: Int64[np.ndarray, "n"],
    certain: Int64[np.ndarray, "k"],
    disparity_px: Float64[np.ndarray, "k"],
    right_px: Float64[np.ndarray, "m 2"],
    of_right: Pieces,
    right_normal: Float64[np.ndarray, "m 2"],
) -> tuple[Int64[np.ndarray, "c"], Float64[np.ndarray, "c"]]:
    """The samples of the left lines that get a place so, and where along the right points it lies.

    Args:
        point_px, piece: of every sample.
        certain: numbers of the samples whose places are certain, in order, and their disparities.
    """
    is_rest = np.ones(len(piece), bool)
    is_rest[certain] = False
    rest = is_rest.nonzero()[0]
    disparity = expected_px(certain, disparity_px, rest, piece)
    told = np.isfinite(disparity)
    rest, expected = rest[told], point_px[rest[told]]
    expected[:, 0] -= disparity[told]
    nearest = np.asarray(cKDTree(right_px, balanced_tree=False, compact_nodes=False).query(expected)[1], np.int64)
    normal, off = right_normal[nearest], expected - right_px[nearest]
    ahead, down = normal[:, 1], -normal[:, 0]
    by_row, by_disparity = down / ROW_PX**2, ahead / DISPARITY_PX**2
    step = (by_row * off[:, 1] + by_disparity * off[:, 0]) / (by_row * down + by_disparity * ahead)
    number, at = of_right.number[nearest], nearest + step
    within = (at >= of_right.first[number]) & (at <= of_right.last[number])
    across = np.abs((off * normal).sum(axis=1))
    found = within & (across <= ACROSS_PX) & (np.abs(step) <= ALONG_PX)
    return rest[found], at[found]
