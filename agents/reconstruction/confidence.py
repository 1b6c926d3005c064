"""The paper's confidence: a Gaussian of the depth bounds, interpolated along the thread (sections II-F and III).

The whole extent of a region in depth, 2 ε_z, counts. Up to 3 mm it costs nothing, beyond that confidence falls with a
standard deviation of 5 mm. Data in arbitrary units has no millimetres; there the same numbers are taken as shares of
the working distance of 100 mm at which they were published.

Interpolation alone would be sure of a long stretch without any region, such as thread along the image rows, because
its two ends are well known. So the bound also grows with the distance to the nearest region that was measured.
"""

import numpy as np
from jaxtyping import Float64

FLAT_M, DEVIATION_M = 0.003, 0.005
WORKING_DISTANCE_M = 0.1
STEEPEST = 0.3
"""How fast the thread may leave a known depth where nothing is measured, per length along it: some 17 degrees."""


def confidence_along(
    at: Float64[np.ndarray, "c"],
    regions_at: Float64[np.ndarray, "n"],
    bound_depth: Float64[np.ndarray, "n"],
    length: float,
    unit_m: float,
) -> Float64[np.ndarray, "c"]:
    """Confidence in [0, 1] at places along the thread.

    Args:
        at: places along the thread, as shares of its length.
        regions_at: places of the measured regions likewise, not decreasing.
        bound_depth: ε_z of each region in units of `unit_m` metres.
        length: of the thread, in the same unit.
        unit_m: metres per unit; for data in an arbitrary unit see `assumed_unit`.
    """
    with np.errstate(over="ignore"):
        unknown = STEEPEST * length * np.abs(at[:, None] - regions_at).min(axis=1)
        extent_m = 2.0 * (np.interp(at, regions_at, bound_depth) + unknown) * unit_m
        return np.exp(-0.5 * (np.maximum(extent_m - FLAT_M, 0.0) / DEVIATION_M) ** 2)


def assumed_unit(depth: Float64[np.ndarray, "n"]) -> float:
    """Metres per unit if the thread's median depth were the published working distance."""
    return WORKING_DISTANCE_M / float(np.median(depth))
