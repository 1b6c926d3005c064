"""A chart along the thread as bars, of which the heights alone change from frame to frame."""

from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float64

BARS = 100
ALONG = np.linspace(0.0, 1.0, BARS)
"""Shares of the thread's length at which there are bars."""
# made once: Rerun takes longer to find out of what kind the numbers of a chart are than it does for all else in it
_PLACES: Any = rr.components.TensorDataBatch(ALONG).as_arrow_array()
_WIDTHS: Any = rr.components.LengthBatch(np.full(BARS, 1 / BARS)).as_arrow_array()
_KIND = [field.name for field in _PLACES.type.field("buffer").type].index("F64")


def bars_along(heights: Float64[np.ndarray, "n"], rgb: tuple[int, int, int]) -> rr.BarChart:
    """Bars at `ALONG` of these heights."""
    return rr.BarChart(_like_places(heights), abscissa=_PLACES, color=rgb, widths=_WIDTHS)


def _like_places(heights: Float64[np.ndarray, "n"]) -> Any:
    """As many numbers, as Rerun holds those of the places: a structure of a shape, names, and numbers of some kind."""
    kinds = _PLACES.field("buffer")
    places = kinds.field(_KIND)
    numbers = rr.components.ScalarBatch(heights).as_arrow_array()
    children = [kinds.field(kind) for kind in range(kinds.type.num_fields)]
    children[_KIND] = places.from_buffers(places.type, 1, places.buffers()[:2], children=[numbers])
    # of what says which kind each element is, and where
    about = [None, *kinds.buffers()[1:3]]
    buffer = kinds.from_buffers(kinds.type, 1, about, children=children)
    return _PLACES.from_arrays([_PLACES.field("shape"), _PLACES.field("names"), buffer], fields=list(_PLACES.type))
