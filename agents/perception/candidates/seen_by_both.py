"""What of all that looks like thread both eyes show: a thread is in both images, a border's glint in one."""

import numpy as np

from agents.perception.candidates.both_eyes import EVERY, same_place, sampled
from agents.perception.candidates.threads import pieces_of
from schemas.messages import Centrelines
from shared.disparities import Disparities


def length_in_common_px(lines: tuple[Centrelines, Centrelines], reach: Disparities) -> float:
    """The length of what both eyes show of the lines of a rectified pair, in the eye that shows less of it."""
    left, right = lines
    of_left, of_right = pieces_of(left), pieces_of(right)
    if not (of_left and of_right):
        return 0.0
    left_px, right_px = left.point_px[sampled(of_left)[0]], right.point_px[sampled(of_right)[0]]
    same, _ = same_place(left_px, right_px, np.ones((len(left_px), len(right_px)), bool), reach)
    return float(EVERY * min(np.count_nonzero(same.any(axis=axis)) for axis in (0, 1)))
