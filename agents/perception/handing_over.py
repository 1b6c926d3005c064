"""Whether the frames after a look at the whole may be left to a segmenter that takes less time near a known thread.

It may where both find the same middle of the thread in the very same image: what the slower one is better at is not in
view then. That is asked once after each look at the whole, by which the slower one has its say again.
"""

import cv2
import numpy as np
from jaxtyping import Int64, UInt8
from scipy.spatial import cKDTree

from agents.perception.centrelines.glints import without_glints
from agents.perception.centrelines.skeleton import skeleton_paths
from agents.perception.segmenter_names import NETWORK, RIDGE

FASTER_NEAR = {NETWORK: RIDGE}
"""A segmenter, and the one that is faster near a known thread."""
APART_PX, APART_SHARE = 2, 0.005
"""Of what one finds, how much at most may lie farther from what the other one finds: what differs by more is no trifle,
and to be told without any middle."""
MIDDLE_PX, MIDDLE_SHARE = 2.0, 0.985
"""How much of both middles at least lies within that distance of the other one; they are lines of whole pixels here."""


def find_the_same(one: UInt8[np.ndarray, "h w"], other: UInt8[np.ndarray, "h w"]) -> bool:
    """Whether two coverages of an image are of the same thread, and have the same middle."""
    if not one.any() or not other.any() or not (_holds(one, other) and _holds(other, one)):
        return False
    middles = _middle(one), _middle(other)
    return min(map(len, middles)) > 0 and _lies_on(*middles) and _lies_on(*middles[::-1])


def _holds(one: UInt8[np.ndarray, "h w"], other: UInt8[np.ndarray, "h w"]) -> bool:
    around = cv2.dilate(one, np.ones((2 * APART_PX + 1,) * 2, np.uint8))
    return float(np.count_nonzero(cv2.subtract(other, around))) <= APART_SHARE * float(np.count_nonzero(other))


def _middle(coverage: UInt8[np.ndarray, "h w"]) -> Int64[np.ndarray, "n 2"]:
    """Pixels of the skeleton, as rows and columns."""
    return skeleton_paths(*without_glints(coverage > 0)).pixel


def _lies_on(points: Int64[np.ndarray, "n 2"], others: Int64[np.ndarray, "m 2"]) -> bool:
    distance = np.asarray(cKDTree(others).query(points, distance_upper_bound=2 * MIDDLE_PX)[0], np.float64)
    return float((distance <= MIDDLE_PX).mean()) >= MIDDLE_SHARE
