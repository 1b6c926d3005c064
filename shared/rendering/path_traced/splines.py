"""The curve that Mitsuba draws and the truth alike: a uniform cubic B-spline that is not clamped.

With control points c_0 … c_{m−1} it starts at (c_0 + 4 c_1 + c_2) / 6 and ends alike at the other side. Lengths in mm,
points in the left camera's frame.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import BSpline
from scipy.linalg import solve_banded
from scipy.spatial import cKDTree

from schemas.messages import RectifiedStereo
from shared.rendering.centreline import Thread
from shared.rendering.surface import Surface
from shared.rendering.thread_shapes import thread_on
from shared.splines import evaluate

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


DYES = {
    "violet": (0.090, 0.022, 0.145),
    "blue": (0.022, 0.045, 0.190),
    "green": (0.020, 0.085, 0.040),
    "black": (0.012, 0.012, 0.014),
    "undyed": (0.72, 0.69, 0.61),
    "red": (0.330, 0.022, 0.024),
    "beige": (0.50, 0.38, 0.24),
    "white": (0.82, 0.82, 0.80),
    "grey": (0.24, 0.24, 0.25),
}
"""Linear reflectance of the yarn, red first."""
USUAL_DYES = ("violet", "blue", "green", "black", "undyed")
"""One of these is drawn by a seed; red thread, which only its edges and its sheen tell from a vessel, is asked for."""
LAB_DYES = ("beige", "white", "grey", "black", "blue", "violet", "green", "red")
"""One of these is drawn for a lab, whose pads bleed no red."""

GAP_MM = 0.05
FINE = 1200


@dataclass(frozen=True)
class Strand:
    """One thread: its centreline, its radius in mm, its dye."""

    curve: Curve
    radius_mm: float
    dye: str


def strand_of(thread: Thread, dye: str) -> Strand:
    """A thread of the light renderer's shapes as this renderer draws it."""
    s = np.linspace(0.0, 1.0, FINE)
    return Strand(curve_through(evaluate(thread.knots, thread.control_points, thread.degree, s)), thread.radius_mm, dye)


def drawn_strand(
    camera: RectifiedStereo, surface: Surface, config: str, seed: int, radius_mm: float, dye: str
) -> Strand:
    """A thread of a configuration of `shared.rendering.thread_shapes`, laid on the surface.

    Raises:
        ShapeError: where the camera sees too little for it.
    """
    return strand_of(thread_on(camera, surface, config, seed, radius_mm), dye)


def laid_over(strand: Strand, below: list[Strand]) -> Strand:
    """The strand, brought towards the camera as a whole until it passes through none of the others."""
    for _ in range(40):
        short = max((_overlap(strand, other) for other in below), default=0.0)
        if short <= 0:
            break
        nearer = np.round(strand.curve.control_points - np.array([0.0, 0.0, short + 0.02]), 5)
        strand = replace(strand, curve=Curve(nearer))
    return strand


def _overlap(strand: Strand, other: Strand) -> float:
    """By how much the two tubes miss the gap between them, in mm; negative where they clear it."""
    points, _ = sampled(strand.curve, 0.1)
    others, _ = sampled(other.curve, 0.1)
    distance, _ = cKDTree(others).query(points)
    return float(strand.radius_mm + other.radius_mm + GAP_MM - np.min(distance))
