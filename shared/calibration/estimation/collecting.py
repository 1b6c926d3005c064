"""Whether a view that a running camera shows is worth keeping beside those that are kept already."""

import numpy as np

from shared.calibration.estimation.views import View

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
