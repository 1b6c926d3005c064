"""What of all that looks like thread both eyes show: a thread is in both images, a border's glint in one."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from agents.perception.candidates.both_eyes import EVERY, same_place, sampled
from agents.perception.candidates.drawn import Piece
from agents.perception.candidates.threads import pieces_of
from schemas.messages import Centrelines
from shared.disparities import Disparities


@dataclass(frozen=True)
class InCommon:
    """What both eyes show, whatever it looks like.

    Fields:
        pieces: of the lines of either eye, left and right.
        shown: of their points as `sampled` has them, whether the other eye shows them too.
        usual_px: the disparity about which all that is.
    """

    pieces: tuple[list[Piece], list[Piece]]
    shown: tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "m"]]
    usual_px: float

    @property
    def length_px(self) -> float:
        """Its length, in the eye that shows less of it."""
        return float(EVERY * min(np.count_nonzero(shown) for shown in self.shown))

    @property
    def share(self) -> float:
        """Of all that an eye shows, in the eye of which that is less."""
        return min(float(shown.mean()) for shown in self.shown)


def in_common(lines: tuple[Centrelines, Centrelines], reach: Disparities) -> InCommon | None:
    """What both eyes show of the lines of a rectified pair; None where either shows none."""
    left, right = lines
    of_left, of_right = pieces_of(left), pieces_of(right)
    if not (of_left and of_right):
        return None
    left_px, right_px = left.point_px[sampled(of_left)[0]], right.point_px[sampled(of_right)[0]]
    same, usual_px = same_place(left_px, right_px, np.ones((len(left_px), len(right_px)), bool), reach)
    in_left, in_right = (np.asarray(same.any(axis=axis), bool) for axis in (1, 0))
    return InCommon((of_left, of_right), (in_left, in_right), usual_px)
