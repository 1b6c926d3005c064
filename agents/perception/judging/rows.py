"""A constant offset of the rows, taken out before anything is looked for, where it is certain.

Only whole pixels are taken out, by moving the right image's rows, which blurs nothing. What is left, less than a pixel,
is estimated from the thread itself by whoever makes curves of it. A rotation or a magnification is no constant offset:
what was moved would be right in the middle of the image alone.
"""

import numpy as np
from jaxtyping import UInt8

from agents.perception.judging.alignment import ROW_FAULT_SHARE, ROW_NOTE_PX
from agents.perception.judging.correspondence import Correspondence
from schemas.messages import Judgement, Severity

MANY_MATCHES = 80
SURE_PX, REFERENCE_WIDTH_PX = 0.15, 960
"""Standard deviation of an offset that is certain, in an image of that width."""
SCATTERED_PX = 0.6
"""Median distance from one offset, in such an image."""
KEPT_WITHIN_PX = 0.75
"""An offset that was taken out before stays as it is while it is as close as that."""


def is_certain(seen: Correspondence | None, width: int) -> bool:
    """Whether so many places agree so well that what they say needs no thread to confirm it."""
    if seen is None or seen.row_deviation_px is None or seen.scatter_px is None:
        return False
    larger = max(1.0, width / REFERENCE_WIDTH_PX)
    few_doubts = seen.row_deviation_px < SURE_PX * larger and seen.scatter_px < SCATTERED_PX * larger
    return seen.matches >= MANY_MATCHES and few_doubts


def rows_to_move(seen: Correspondence, shape: tuple[int, ...], before: int) -> int:
    """By how many rows the right image is to be moved up, so that what corresponds shares its row; 0 where it does.

    Args:
        seen: certain, of the images as they come.
        before: by how many it was moved before.
    """
    height, width = shape[:2]
    lower = -(seen.row_residual_px or 0.0)
    turned_px = abs(np.radians(seen.rotation_deg or 0.0)) * width / 2
    larger_px = abs((seen.magnification or 1.0) - 1.0) * height / 2
    if max(turned_px, larger_px) > ROW_NOTE_PX or abs(lower) > ROW_FAULT_SHARE * height:
        return 0
    if before and abs(lower - before) < KEPT_WITHIN_PX:
        return before
    return round(lower) if abs(lower) > ROW_NOTE_PX else 0


def moved_up(image: UInt8[np.ndarray, "h w *c"], rows: int) -> UInt8[np.ndarray, "h w *c"]:
    """The image with its content so many rows further up, the rows at its border repeated."""
    if rows == 0:
        return image
    return image[np.clip(np.arange(len(image)) + rows, 0, len(image) - 1)]


def row_offset(seen: Correspondence, rows: int) -> tuple[Judgement, ...]:
    """What is said about rows that were moved."""
    if rows == 0 or seen.row_residual_px is None or seen.row_deviation_px is None:
        return ()
    lower = -seen.row_residual_px
    finding = (
        f"everything lies {abs(lower):.1f} px {'lower' if lower > 0 else 'higher'} in the right image, give or take "
        f"{2 * seen.row_deviation_px:.1f}; it was moved by {abs(rows)} rows before anything was looked for"
    )
    remedy = "calibrate again: something has moved since, and depth may be off as well"
    return (Judgement("row_offset", Severity.WARNING, finding, remedy),)
