"""A chart along the thread as bars, of which the heights alone change from frame to frame."""

import numpy as np
import rerun as rr
from jaxtyping import Float64

BARS = 100
ALONG = np.linspace(0.0, 1.0, BARS)
"""Shares of the thread's length at which there are bars."""
# made once: Rerun takes longer to take in the numbers of a chart than it does for all else in it
_PLACES = rr.components.TensorDataBatch(ALONG).as_arrow_array()
_WIDTHS = rr.components.LengthBatch(np.full(BARS, 1 / BARS)).as_arrow_array()


def bars_along(heights: Float64[np.ndarray, "n"], rgb: tuple[int, int, int]) -> rr.BarChart:
    """Bars at `ALONG` of these heights."""
    return rr.BarChart(heights, abscissa=_PLACES, color=rgb, widths=_WIDTHS)
