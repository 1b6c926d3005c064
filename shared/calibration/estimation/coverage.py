"""What views of a board lack for a calibration, in plain sentences.

A lens is known where corners were seen: in every part of both images. Focal length and distance are told apart by
boards that are tilted, both ways about both axes, and by boards near and far.

A view that a running camera shows is worth keeping where it adds to those that are kept already.
"""

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


CELLS = (3, 4)
"""Rows and columns of the parts that an image is divided into."""
ROW_NAMES, COLUMN_NAMES = ("top", "middle", "bottom"), ("left", "centre left", "centre right", "right")
LEAST_IN_CELL = 5
"""Corners."""
ENOUGH_VIEWS = 15
TILT = 0.1
"""How much larger one side of a board must appear than its opposite one, as a share, to count as tilted."""
NEAR_TO_FAR = 1.3
"""How much larger the board must appear in some views than in others."""


@dataclass(frozen=True)
class Coverage:
    """Where corners were seen, and how boards stood.

    Fields:
        left, right: corners in each part of each image, row by row from the top.
        tilt: of each view, how much larger the board's right side appears than its left one, and its lower side than
            its upper one, as logarithms of ratios.
        apparent: of each view, how many pixels wide a square appears.
    """

    left: Int64[np.ndarray, "r c"]
    right: Int64[np.ndarray, "r c"]
    tilt: Float64[np.ndarray, "n 2"]
    apparent: Float64[np.ndarray, "n"]


def coverage(views: tuple[View, ...], board: Board, image_size: tuple[int, int]) -> Coverage:
    """Of these views."""
    seen = [_counted([getattr(view, eye) for view in views], image_size) for eye in ("left", "right")]
    homographies = [_homography(board.points[view.number, :2] / board.square, view.left) for view in views]
    middle = np.array([board.columns, board.rows]) / 2
    stands = [_stands(H, middle) for H in homographies]
    return Coverage(
        seen[0],
        seen[1],
        np.array([tilt for tilt, _ in stands]).reshape(-1, 2),
        np.array([size for _, size in stands]),
    )


def lacking(covered: Coverage) -> list[str]:
    """What to show next, the most helpful first; empty where nothing is missing."""
    told: list[str] = []
    for eye, cells in (("left", covered.left), ("right", covered.right)):
        empty = np.argwhere(cells < LEAST_IN_CELL)
        if len(empty):
            names = ", ".join(f"{ROW_NAMES[row]} {COLUMN_NAMES[column]}" for row, column in empty)
            told.append(f"too few corners in the {eye} image's {names}: show the board there")
    count = len(covered.apparent)
    if count == 0:
        return ["no view yet: show the whole board to both eyes"]
    sideways, upright = covered.tilt.T
    for seen, ways in ((sideways, ("right", "left")), (upright, ("lower", "upper"))):
        for sign, side in zip((1, -1), ways, strict=True):
            if (sign * seen < TILT).all():
                told.append(
                    f"no view with the board's {side} side clearly nearer: tilt it so, by some 20 to 40 degrees"
                )
    if covered.apparent.max() < NEAR_TO_FAR * covered.apparent.min():
        told.append("all views are from one distance: hold the board nearer, and farther away")
    if count < ENOUGH_VIEWS:
        told.append(f"{count} views: {ENOUGH_VIEWS - count} more would make it surer")
    return told


def _counted(places: list[Float64[np.ndarray, "n 2"]], image_size: tuple[int, int]) -> Int64[np.ndarray, "r c"]:
    rows, columns = CELLS
    px = np.concatenate(places) if places else np.zeros((0, 2))
    column = np.clip((px[:, 0] / image_size[0] * columns).astype(int), 0, columns - 1)
    row = np.clip((px[:, 1] / image_size[1] * rows).astype(int), 0, rows - 1)
    return np.bincount(row * columns + column, minlength=rows * columns).reshape(rows, columns)


def _homography(on_board: Float64[np.ndarray, "n 2"], px: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "3 3"]:
    """From squares of the board to pixels, by least squares (the direct linear transform)."""
    centre, spread = px.mean(axis=0), float(px.std()) or 1.0
    u, v = ((px - centre) / spread).T
    x, y = on_board.T
    one, none = np.ones_like(x), np.zeros_like(x)
    rows = np.concatenate(
        (
            np.column_stack((x, y, one, none, none, none, -u * x, -u * y, -u)),
            np.column_stack((none, none, none, x, y, one, -v * x, -v * y, -v)),
        )
    )
    H = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    return np.array([[spread, 0, centre[0]], [0, spread, centre[1]], [0, 0, 1.0]]) @ H


def _stands(H: Float64[np.ndarray, "3 3"], middle: Float64[np.ndarray, "2"]) -> tuple[Float64[np.ndarray, "2"], float]:
    """Tilt along the image's axes, and the size of a square in the middle of the board.

    The depth of a board's point (x, y) is in proportion to the last row of H at (x, y, 1).
    """
    at = np.array([*middle, 1.0])
    w = H[2] @ at
    px = H[:2] @ at / w
    jacobian = (H[:2, :2] - np.outer(px, H[2, :2])) / w
    size = float(np.sqrt(abs(np.linalg.det(jacobian))))
    # how the logarithm of nearness changes along the board, turned to the image's axes, over the board's own extent
    along = -H[2, :2] / w
    per_pixel = np.linalg.solve(jacobian.T, along)
    return per_pixel * size * 2 * float(middle.min()), size


MOVED_SHARE = 0.06
"""Of the image's width: how far corners must be, on average, from where they are in every kept view."""
STILL_SHARE = 0.003
"""Of the width: how far they may have moved since the frame before; a moving board is smeared, and each eye may see it
at a moment of its own."""


def why_not(view: View, before: View | None, kept: tuple[View, ...], width: int) -> str:
    """Why a view is not worth keeping, in a few words; empty where it is."""
    if before is None or _moved_px(view, before) > STILL_SHARE * width:
        return "hold the board still"
    if any(_moved_px(view, other) < MOVED_SHARE * width for other in kept):
        return "move or tilt the board: it was seen so before"
    return ""


def _moved_px(view: View, other: View) -> float:
    """How far the corners that both views share are apart in the left image, on average."""
    _, here, there = np.intersect1d(view.number, other.number, return_indices=True)
    if len(here) == 0:
        return float("inf")
    return float(np.linalg.norm(view.left[here] - other.left[there], axis=1).mean())
