"""Stereo views of a board, and what of them both eyes share."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from shared.calibration.estimation.board import LEAST_CORNERS, Board, Corners, alike, corners_of


@dataclass(frozen=True)
class View:
    """The corners of a board that both eyes see in one pair.

    Fields:
        number: of each corner, ascending.
        left, right: its pixel in each image.
    """

    name: str
    number: Int64[np.ndarray, "n"]
    left: Float64[np.ndarray, "n 2"]
    right: Float64[np.ndarray, "n 2"]


@dataclass(frozen=True)
class NoView:
    """A pair that tells nothing, and why."""

    name: str
    reason: str


def view_of(
    name: str,
    left: UInt8[np.ndarray, "h w *c"],
    right: UInt8[np.ndarray, "h w *c"],
    board: Board,
    thorough: bool = True,
) -> View | NoView:
    """What both eyes see of a board; `thorough` as in `corners_of`."""
    seen = corners_of(left, board, thorough), corners_of(right, board, thorough)
    if seen[0] is None or seen[1] is None:
        missing = " and ".join(eye for eye, corners in zip(("left", "right"), seen, strict=True) if corners is None)
        return NoView(name, f"the board was not found in the {missing} image; show all of it, in focus, without glare")
    return shared_view(name, seen[0], seen[1])


def shared_view(name: str, left: Corners, right: Corners) -> View | NoView:
    """The corners that were found in both images of a pair."""
    right = alike(left, right)
    number, of_left, of_right = np.intersect1d(left.number, right.number, return_indices=True)
    if len(number) < LEAST_CORNERS:
        return NoView(name, f"both eyes share {len(number)} corners, and at least {LEAST_CORNERS} are needed")
    return View(name, number, left.px[of_left], right.px[of_right])
