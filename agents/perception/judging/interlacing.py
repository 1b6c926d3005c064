"""Whether an image is woven from two fields of different moments, which frame grabbers do with interlaced signals.

Where things moved in between, every other row is displaced, and a pixel is brighter than both of its neighbours above
and below, or darker than both. Texture and noise do that along the columns as often as along the rows; only fields do
it along the columns alone. A scene that stands still tells nothing.
"""

import numpy as np
from jaxtyping import UInt8

STEP = 10
"""Grey levels from a pixel to its neighbour."""
LEAST_STEPS = 500


def combed(grey: UInt8[np.ndarray, "h w"]) -> tuple[float, float]:
    """Shares of the strong steps along the columns, and along the rows, that are teeth: up, down and up again.

    NaN where there are too few of them to tell.
    """
    level = grey.astype(np.int16)
    return _teeth(level), _teeth(np.ascontiguousarray(level.T))


def _teeth(level: np.ndarray) -> float:
    step = level[1:] - level[:-1]
    strong = np.abs(step) > STEP
    three = strong[:-2] & strong[1:-1] & strong[2:]
    teeth = three & ((step[:-2] ^ step[1:-1]) < 0) & ((step[1:-1] ^ step[2:]) < 0)
    steps = np.count_nonzero(strong)
    return np.count_nonzero(teeth) / steps if steps >= LEAST_STEPS else np.nan
