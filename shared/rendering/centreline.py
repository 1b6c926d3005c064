"""The thread's centreline, sampled finely enough that its projection is a polyline without visible corners.

Lengths are in millimetres throughout shared.rendering, and points are in the rectified left camera's frame.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.splines import evaluate

NEAR_MM = 20.0
"""Nothing nearer than this is drawn: an endoscope does not focus there, and discs would fill the image."""

SPACING_PX = 1.0
SPACING_MM = 0.5
COARSE_SAMPLES = 600


@dataclass(frozen=True)
class Thread:
    """A clamped B-spline centreline with a radius, in millimetres in the left camera's frame."""

    knots: Float64[np.ndarray, "k"]
    control_points: Float64[np.ndarray, "m 3"]
    radius_mm: float
    degree: int = 3


@dataclass(frozen=True)
class Centreline:
    """Samples of a thread: points and tangents (not normalised) in mm, arc length from the start in mm."""

    points_camera: Float64[np.ndarray, "n 3"]
    tangents_camera: Float64[np.ndarray, "n 3"]
    arc_mm: Float64[np.ndarray, "n"]


def sample_centreline(camera: RectifiedStereo, thread: Thread) -> Centreline:
    """Samples at most a pixel apart in either image and half a millimetre apart in space, both ends included."""
    coarse = np.linspace(thread.knots[0], thread.knots[-1], COARSE_SAMPLES)
    points = evaluate(thread.knots, thread.control_points, thread.degree, coarse)
    steps = np.concatenate(([0.0], np.cumsum(_steps_between(camera, points))))
    count = int(np.ceil(steps[-1])) + 2
    s = np.interp(np.linspace(0.0, steps[-1], count), steps, coarse)
    points = evaluate(thread.knots, thread.control_points, thread.degree, s)
    tangents = evaluate(thread.knots, thread.control_points, thread.degree, s, 1)
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    return Centreline(points, tangents, arc)


def shifted_to_right(camera: RectifiedStereo, centreline: Centreline) -> Centreline:
    """The same samples in the right camera's frame, where they project as the left ones do in the left."""
    return replace(centreline, points_camera=centreline.points_camera - np.array([camera.baseline, 0.0, 0.0]))


def _steps_between(camera: RectifiedStereo, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m"]:
    """How many samples each stretch needs; what lies outside the images counts by its length in space alone."""
    in_front = points.copy()
    in_front[:, 2] = np.maximum(points[:, 2], NEAR_MM)
    window = np.array([camera.image_width, camera.image_height], dtype=np.float64)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1) / SPACING_MM
    for pixels in project(camera, in_front):
        seen = np.clip(pixels, -0.5 * window, 1.5 * window)
        steps = np.maximum(steps, np.linalg.norm(np.diff(seen, axis=0), axis=1) / SPACING_PX)
    return steps
