"""Threads as they lie in a scene: which, how many, how thick and of which colour."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from schemas.messages import RectifiedStereo
from shared.scene.centreline import Thread
from shared.scene.path_traced.splines import Curve, curve_through, sampled
from shared.scene.surface import Surface
from shared.scene.thread_shapes import thread_on
from shared.splines import evaluate

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
    """A thread of a configuration of `shared.scene.thread_shapes`, laid on the surface.

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
        strand = moved(strand, np.array([0.0, 0.0, -(short + 0.02)]))
    return strand


def moved(strand: Strand, by_mm: Float64[np.ndarray, "3"]) -> Strand:
    """The strand elsewhere."""
    return replace(strand, curve=Curve(np.round(strand.curve.control_points + by_mm, 5)))


def _overlap(strand: Strand, other: Strand) -> float:
    """By how much the two tubes miss the gap between them, in mm; negative where they clear it."""
    points, _ = sampled(strand.curve, 0.1)
    others, _ = sampled(other.curve, 0.1)
    distance, _ = cKDTree(others).query(points)
    return float(strand.radius_mm + other.radius_mm + GAP_MM - np.min(distance))
