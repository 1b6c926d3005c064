"""The board whose views a camera is calibrated by, and where its corners are found in an image.

A chessboard is found as a whole (Duda and Frese 2018), a ChArUco board also in part: its markers say which corner is
which. Corners are numbered row by row from the board's origin.
"""

from dataclasses import dataclass
from functools import cached_property
from math import inf

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from shared.calibration.stated import CalibrationError

FEWEST_SQUARES, MOST_SQUARES = 3, 100
LEAST_CORNERS = 8
"""Of a board that is seen in part: fewer do not tell how it stands."""
FAST_WIDTH_PX = 960
"""Of the reduced image in which a whole chessboard is looked for first, since to find none takes seconds."""


@dataclass(frozen=True)
class Board:
    """A chessboard of `columns` by `rows` squares, with markers in its white squares for ChArUco.

    Fields:
        square: side of a square, in the unit that the calibration is to have.
        marker: side of a marker, in the same unit; None for a chessboard.
        dictionary: OpenCV's name of the markers' dictionary.
        legacy: whether it was printed by OpenCV before 4.6, which began boards of even rows with the other colour.
    """

    columns: int
    rows: int
    square: float
    marker: float | None = None
    dictionary: str = "DICT_4X4_250"
    legacy: bool = False

    def __post_init__(self) -> None:
        if not all(FEWEST_SQUARES <= side <= MOST_SQUARES for side in (self.columns, self.rows)):
            raise CalibrationError(f"a board of {self.columns}x{self.rows} squares is none; count squares, not corners")
        if not 0 < self.square < inf:
            raise CalibrationError("the side of a square must be a positive number")
        if self.marker is not None and not 0 < self.marker < self.square:
            raise CalibrationError("a marker must be smaller than the square that it stands in")
        if self.marker is not None:
            self._check_dictionary()

    def _check_dictionary(self) -> None:
        if not (self.dictionary.startswith("DICT_") and hasattr(cv2.aruco, self.dictionary)):
            raise CalibrationError(f"OpenCV has no dictionary {self.dictionary}; DICT_4X4_250 is one")
        # of an odd number of squares, the one left over is black
        held, needed = len(_markers(self.dictionary).bytesList), self.columns * self.rows // 2
        if held < needed:
            raise CalibrationError(
                f"a board of {self.columns}x{self.rows} squares has {needed} markers, and {self.dictionary} only "
                f"{held}; name the dictionary that the board was printed with"
            )

    @cached_property
    def points(self) -> Float64[np.ndarray, "c 3"]:
        """Every inner corner on the board, z 0, by number."""
        across, down = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return self.square * np.column_stack((across.ravel(), down.ravel(), np.zeros(across.size))).astype(np.float64)

    @cached_property
    def neighbours(self) -> Int64[np.ndarray, "p 2"]:
        """Numbers of the corners at both ends of every side between inner corners."""
        number = np.arange((self.columns - 1) * (self.rows - 1)).reshape(self.rows - 1, self.columns - 1)
        across = np.column_stack((number[:, :-1].ravel(), number[:, 1:].ravel()))
        down = np.column_stack((number[:-1].ravel(), number[1:].ravel()))
        return np.concatenate((across, down))


@dataclass(frozen=True)
class Corners:
    """Corners found in one image: their numbers, ascending, and their pixels (u, v)."""

    number: Int64[np.ndarray, "n"]
    px: Float64[np.ndarray, "n 2"]

    def only(self, which: Bool[np.ndarray, "n"]) -> "Corners":
        """Some of them."""
        return Corners(self.number[which], self.px[which])


def corners_of(image: UInt8[np.ndarray, "h w *c"], board: Board, thorough: bool = True) -> Corners | None:
    """The board's corners in an image, to a fraction of a pixel; None where it is not found.

    Args:
        thorough: whether a third of a chessboard's error is worth three times the time.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    return _chessboard(grey, board, thorough) if board.marker is None else _charuco(grey, board, board.marker)


def alike(left: Corners, right: Corners) -> Corners:
    """The right corners, numbered from the same end of the board as the left ones.

    A chessboard looks the same from both of its ends, and both eyes see it the same way up.
    """
    (of_left, of_right), count = (corners.px[-1] - corners.px[0] for corners in (left, right)), len(left.number)
    if len(right.number) != count or of_left @ of_right >= 0:
        return right
    return Corners(right.number, right.px[::-1].copy())


def _chessboard(grey: UInt8[np.ndarray, "h w"], board: Board, thorough: bool) -> Corners | None:
    inner = (board.columns - 1, board.rows - 1)
    share = min(1.0, FAST_WIDTH_PX / grey.shape[1])
    if share < 1:
        small = cv2.resize(grey, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        if not cv2.findChessboardCornersSB(small, inner, flags=0)[0]:
            return None
    found, corners = cv2.findChessboardCornersSB(grey, inner, flags=cv2.CALIB_CB_ACCURACY if thorough else 0)
    if not found:
        return None
    px = np.asarray(corners, np.float64).reshape(-1, 2)
    return Corners(np.arange(len(px)), px)


def _charuco(grey: UInt8[np.ndarray, "h w"], board: Board, marker: float) -> Corners | None:
    size = board.columns, board.rows
    pattern = cv2.aruco.CharucoBoard(size, board.square, marker, _markers(board.dictionary))
    pattern.setLegacyPattern(board.legacy)
    corners, numbers, *_ = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
    # where there are none OpenCV gives None, which its stub does not know
    number = np.asarray(numbers if corners is not None else (), np.int64).ravel()  # pyright: ignore[reportUnnecessaryComparison]
    if len(number) < LEAST_CORNERS:
        return None
    order = np.argsort(number)
    return Corners(number[order], np.asarray(corners, np.float64).reshape(-1, 2)[order])


def _markers(dictionary: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
