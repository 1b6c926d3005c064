"""The curve that Mitsuba draws and the truth alike: a uniform cubic B-spline that is not clamped.

With control points c_0 … c_{m−1} it starts at (c_0 + 4 c_1 + c_2) / 6 and ends alike at the other side. Lengths in mm,
points in the left camera's frame.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import BSpline
from scipy.linalg import solve_banded

SPACING_MM = 1.0
TRUTH_STEP_MM = 0.05


@dataclass(frozen=True)
class Curve:
    """A uniform cubic B-spline by its control points."""

    control_points: Float64[np.ndarray, "m 3"]

    @property
    def spans(self) -> int:
        """How many polynomial pieces it has; its parameter runs from 0 to this."""
        return len(self.control_points) - 3

    def at(self, parameters: Float64[np.ndarray, "n"], derivative: int = 0) -> Float64[np.ndarray, "n 3"]:
        """Points, or derivatives by the parameter, at parameters between 0 and `spans`."""
        knots = np.arange(-3.0, self.spans + 4.0)
        spline = BSpline(knots, self.control_points, 3)
        inside = np.clip(parameters, 0.0, np.nextafter(self.spans, 0.0))
        return np.asarray(spline(inside, nu=derivative), dtype=np.float64)


def curve_through(polyline: Float64[np.ndarray, "n 3"], spacing_mm: float = SPACING_MM) -> Curve:
    """The curve through points of a fine polyline that are evenly spaced along it, with straight ends."""
    arc = arc_lengths(polyline)
    count = max(round(float(arc[-1]) / spacing_mm), 4) + 1
    even = np.linspace(0.0, arc[-1], count)
    points = np.column_stack([np.interp(even, arc, axis) for axis in polyline.T])
    # natural ends: the second derivative c_0 − 2 c_1 + c_2 vanishes, so that c_1 is the first point itself
    inner = points.copy()
    inner[1] -= points[0] / 6.0
    inner[-2] -= points[-1] / 6.0
    bands = np.ones((3, count - 2)) / 6.0
    bands[1] = 4.0 / 6.0
    middle = solve_banded((1, 1), bands, inner[1:-1])
    known = np.vstack((points[:1], middle, points[-1:]))
    first = 2.0 * known[0] - known[1]
    last = 2.0 * known[-1] - known[-2]
    # what is written to files has five decimals, so what is drawn has them too
    return Curve(np.round(np.vstack((first, known, last)), 5))


def sampled(
    curve: Curve, step_mm: float = TRUTH_STEP_MM
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n"]]:
    """Points about evenly spaced along the curve, both ends included, and their arc lengths from its start."""
    fine = np.linspace(0.0, curve.spans, 40 * curve.spans + 1)
    arc = arc_lengths(curve.at(fine))
    count = max(round(float(arc[-1]) / step_mm), 2) + 1
    even = np.linspace(0.0, arc[-1], count)
    return curve.at(np.interp(even, arc, fine)), even


def end_directions(curve: Curve) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Unit vectors that point out of the curve at its start and at its end."""
    start, end = curve.at(np.array([0.0, float(curve.spans)]), 1)
    return -start / np.linalg.norm(start), end / np.linalg.norm(end)


def arc_lengths(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
    """Length along the polyline up to each of its points."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
