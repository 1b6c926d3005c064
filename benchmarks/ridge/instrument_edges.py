"""Instruments in a reduced image, whose edges are lines too.

An instrument is dark towards its sides, and darker than the ground in its own shadow, so that its outline looks like
dark thread. What tells it is the region that it belongs to (`occluders`), and that it runs along the border of that.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8

from benchmarks.ridge.hue_occluders import WIDTH_PX, occluders_in
from benchmarks.ridge.line_filter import across_lines

ABOUT_CELLS, WITHIN_CELLS = 3, 2
"""Of the map of occluders, which is 240 px wide: how far beyond an instrument's border, and how far within it, its edge
may lie."""
SLOPE_CELLS = 9
"""Side of the window over which the direction of a border is averaged."""
LEAST_COSINE = 0.93
"""Between the directions across a line and across a border: less than 21 degrees apart is along it."""


@dataclass(frozen=True)
class Instruments:
    """Where instruments are in a reduced image, or in a part of it.

    Fields:
        about: within them, or close to them.
        border: within a band along their borders.
        across: of each pixel, the direction across the border (columns, rows), of any length.
    """

    about: Bool[np.ndarray, "h w"]
    border: Bool[np.ndarray, "h w"]
    across: tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]

    def part(self, rows: slice, columns: slice) -> "Instruments":
        """Those in some rows and columns."""
        at = np.s_[rows, columns]
        return Instruments(self.about[at], self.border[at], (self.across[0][at], self.across[1][at]))


def instruments_in(reduced: UInt8[np.ndarray, "h w 3"]) -> Instruments | None:
    """The instruments in a reduced image; None where there are none, or the image does not tell."""
    if min(reduced.shape[:2]) < SLOPE_CELLS or reduced.shape[1] < WIDTH_PX:
        return None
    found = occluders_in(reduced, np.zeros(reduced.shape[:2], np.uint8))
    if found is None or not found.any():
        return None
    region = (found > 0).view(np.uint8)
    about = cv2.dilate(region, _disc(ABOUT_CELLS))
    # an instrument goes on beyond the image
    border = cv2.subtract(about, cv2.erode(region, _disc(WITHIN_CELLS), borderValue=1))
    soft = cv2.blur(region.astype(np.float32), (SLOPE_CELLS, SLOPE_CELLS))
    slopes = cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)
    size = reduced.shape[1::-1]
    is_about, is_border = (
        cv2.resize(part, size, interpolation=cv2.INTER_NEAREST).view(bool) for part in (about, border)
    )
    u, v = (np.asarray(cv2.resize(slope, size, interpolation=cv2.INTER_LINEAR), np.float32) for slope in slopes)
    return Instruments(is_about, is_border, (u, v))


def along_borders(
    instruments: Instruments, contrast: Float32[np.ndarray, "h w"], pixel: Int64[np.ndarray, "p"]
) -> Bool[np.ndarray, "p"]:
    """Which of some pixels, by their indices, are of lines of a contrast that run along the border of an instrument."""
    along = instruments.border.ravel()[pixel]
    asked = pixel[along]
    line = across_lines(contrast, asked)
    border = np.column_stack([part.ravel()[asked] for part in instruments.across])
    cosine = np.abs(np.einsum("pc,pc->p", line, border))
    along[along] = cosine > LEAST_COSINE * np.sqrt(np.einsum("pc,pc->p", border, border))
    return along


def _disc(radius: int) -> UInt8[np.ndarray, "k k"]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)
