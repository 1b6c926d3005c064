"""How the two images lie to each other by the thread alone, on a ground that shows nothing.

A thread that both eyes see covers the same rows in both.
"""

import numpy as np
from jaxtyping import Bool

from agents.perception.judging.correspondence import UNKNOWN, Correspondence

ROW_SEARCH_SHARE = 0.04
"""How far rows are searched for each other, as a share of the image's height."""
LEAST_AGREEMENT, CLEARLY_BETTER = 0.4, 1.05
"""Of the row profiles of two masks: to say anything at all, and to say that another shift fits better than none.
Clean pairs stay below 1.01 and pairs that are 4 px apart lie above 1.06, unless the thread fills its rows evenly."""


def correspondence_of_masks(
    segmented_left: Bool[np.ndarray, "h w"], segmented_right: Bool[np.ndarray, "h w"]
) -> Correspondence:
    """From the thread alone: the shift of rows at which both masks fill rows alike, then the columns of those rows."""
    count_left, count_right = segmented_left.sum(axis=1), segmented_right.sum(axis=1)
    if not count_left.any() or not count_right.any():
        return UNKNOWN
    reach = max(2, round(ROW_SEARCH_SHARE * len(count_left)))
    shift = _row_shift(count_left, count_right, reach)
    columns = np.arange(segmented_left.shape[1])
    both = (count_left > 0) & (count_right > 0)
    if not both.any():
        return Correspondence(shift, None)
    mean_left = (segmented_left[both] @ columns) / count_left[both]
    mean_right = (segmented_right[both] @ columns) / count_right[both]
    return Correspondence(shift, float(np.median(mean_left - mean_right)))


def _row_shift(count_left: np.ndarray, count_right: np.ndarray, reach: int) -> float | None:
    """The shift of rows at which both profiles agree best, 0 unless another is clearly better; None if none agrees."""
    shifts = np.arange(-reach, reach + 1)
    padded = np.pad(count_right, reach)
    shifted = np.array([padded[reach - shift : reach - shift + len(count_left)] for shift in shifts])
    agreement = np.minimum(count_left, shifted).sum(axis=1) / np.maximum(count_left, shifted).sum(axis=1)
    if agreement.max() < LEAST_AGREEMENT:
        return None
    if agreement.max() < CLEARLY_BETTER * agreement[reach]:
        return 0.0
    return float(np.median(shifts[agreement == agreement.max()]))
