"""How much of a thread's true centreline perception finds in one image, and how much of what it finds is thread."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import KDTree

from schemas.messages import Centrelines
from shared.curve_distance import distances_to_polyline

NEAR_PX = 2.0
"""What lies within that of the other counts as the same."""


@dataclass(frozen=True)
class Shares:
    """Counts of places about a pixel apart, whose shares are recall and precision.

    Fields:
        found, true: places on the true centreline that the image shows; those near what was found, and all.
        right, given: places that were found; those near the true centreline, and all.
        apart_px: how far each right place lies from the true centreline, to its left or right.
        deviation_px: how far it may lie off, as perception says.
    """

    found: int
    true: int
    right: int
    given: int
    apart_px: Float64[np.ndarray, "n"]
    deviation_px: Float64[np.ndarray, "n"]


def shares(lines: Centrelines, truth_px: Float64[np.ndarray, "m 2"], visible: Bool[np.ndarray, "m"]) -> Shares:
    """Centrelines of one image against the projected truth, of which the visible part counts.

    Args:
        truth_px: evenly spaced along the thread, less than a pixel apart.
    """
    step = np.linalg.norm(np.diff(truth_px, axis=0, prepend=truth_px[:1]), axis=1)
    # a place for each pixel of the way, so that a thread that comes towards the camera does not count for more
    whole = np.floor(np.cumsum(step))
    places = truth_px[(np.diff(whole, prepend=-1) > 0) & visible]
    points = lines.point_px
    if len(points) == 0 or len(places) == 0:
        return Shares(0, len(places), 0, len(points), np.zeros(0), np.zeros(0))
    near_found = np.asarray(KDTree(points).query(places)[0]) <= NEAR_PX
    # what is hidden lies between what is seen: a polyline through the seen parts alone would bridge it
    apart = distances_to_polyline(points, truth_px)
    near_seen = np.asarray(KDTree(truth_px[visible]).query(points)[0]) <= NEAR_PX
    return Shares(
        found=int(near_found.sum()),
        true=len(places),
        right=int(near_seen.sum()),
        given=len(points),
        apart_px=apart[near_seen],
        deviation_px=lines.deviation_px[near_seen],
    )
