"""The field: a thread on tissue, and what a jaw does to the thread. Metres, in the left camera's frame.

No forces are computed. A thread that is held at s₀ and carried by D from where it lay is laid along the curve

    C(s) = B(s) + w(d) D,   w(d) = (1 − (d / R)²)³ for d < R, else 0,   d = |s − s₀| · length

at its own length, measured from s₀ both ways. So it keeps its length, what lies far from the jaw moves along the thread
only, and its free ends are drawn in or pushed out. Tissue does not give: no part of the thread goes below its surface.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo
from shared.arc_length import even_parameters, length
from shared.camera import project
from shared.rendering.centreline import Thread
from shared.rendering.render import surface_of
from shared.rendering.surface import Surface, depth_at_points
from shared.rendering.thread_shapes import thread_on
from shared.splines import basis_matrix, clamped_uniform_knots, evaluate

MM = 1e-3
SAMPLES = 801
DEGREE = 3
CONTROL_SPACING_M = 2.0 * MM
LEAST_REACH_M = 25.0 * MM
REACH_PER_LIFT = 2.0
"""R over |D|: at 2, a lifted thread rises at 45° or so where it is steepest."""


@dataclass(frozen=True, eq=False)
class Field:
    """A thread over tissue; one is the same as another only where it is that very one.

    Fields:
        knots, control_points: the thread as a clamped cubic B-spline, s = 0 where the left image shows it first.
        points: SAMPLES places along it; evenly spaced, but for what a fit leaves.
        length_m: as drawn, which stays.
        height_m: of each sample above the tissue, as drawn.
        surface: of the tissue, in mm.
    """

    knots: Float64[np.ndarray, "k"]
    control_points: Float64[np.ndarray, "m 3"]
    points: Float64[np.ndarray, "n 3"]
    length_m: float
    radius_m: float
    height_m: Float64[np.ndarray, "n"]
    surface: Surface


def field_of(camera: RectifiedStereo, config: str, background: str, distance_mm: float, seed: int) -> Field:
    """The field that shared.rendering draws for a configuration; the camera is in millimetres.

    Raises:
        SceneError, ShapeError: where there is no such background or configuration, or it does not fit the view.
    """
    surface = surface_of(camera, background, distance_mm, seed)
    return field_with(starting_first(camera, thread_on(camera, surface, config, seed)), surface)


def field_with(thread: Thread, surface: Surface) -> Field:
    """A field with a given thread, in millimetres as in shared.rendering."""
    control_points = MM * thread.control_points
    s = even_parameters(thread.knots, control_points, DEGREE, SAMPLES)
    points = evaluate(thread.knots, control_points, DEGREE, s)
    total = length(thread.knots, control_points, DEGREE)
    height = np.maximum(_floor(surface, points) - points[:, 2], 0.0)
    return Field(thread.knots, control_points, points, total, MM * thread.radius_mm, height, surface)


def s_of(sample: int) -> float:
    """Where along the thread a sample lies."""
    return sample / (SAMPLES - 1)


def carried(field: Field, sample: int, to_camera: Float64[np.ndarray, "3"]) -> Field:
    """The field once a jaw has carried one sample of the thread to a point."""
    lift = to_camera - field.points[sample]
    distance = np.abs(np.arange(SAMPLES) - sample) / (SAMPLES - 1) * field.length_m
    reach = max(LEAST_REACH_M, REACH_PER_LIFT * float(np.linalg.norm(lift)))
    weight = np.maximum(1.0 - (distance / reach) ** 2, 0.0) ** 3
    return _fitted(field, _above(field, _laid_along(field.points + weight[:, None] * lift, sample, field.length_m)))


def settled(field: Field, sample: int) -> Field:
    """The field once the thread was let go there: what was lifted falls straight down to its height as drawn."""
    fallen = _laid_along(_fallen(field, field.points), sample, field.length_m)
    return _fitted(field, _fallen(field, fallen))


def distance_to_thread(field: Field, point_camera: Float64[np.ndarray, "3"]) -> float:
    """How far a point is from the thread's centreline."""
    start, step = field.points[:-1], np.diff(field.points, axis=0)
    along = np.einsum("ij,ij->i", point_camera - start, step) / np.einsum("ij,ij->i", step, step)
    foot = start + np.clip(along, 0.0, 1.0)[:, None] * step
    return float(np.linalg.norm(foot - point_camera, axis=1).min())


def _laid_along(curve: Float64[np.ndarray, "n 3"], sample: int, total_m: float) -> Float64[np.ndarray, "n 3"]:
    """A thread of that length along a curve, one sample being where the curve has it; its ends go on straight."""
    step = np.diff(curve, axis=0)
    chord = np.linalg.norm(step, axis=1)
    way = np.concatenate(([0.0], np.cumsum(chord)))
    wanted = way[sample] + (np.arange(SAMPLES) - sample) / (SAMPLES - 1) * total_m
    laid = np.column_stack([np.interp(wanted, way, axis) for axis in curve.T])
    laid += np.minimum(wanted, 0.0)[:, None] * step[0] / chord[0]
    laid += np.maximum(wanted - way[-1], 0.0)[:, None] * step[-1] / chord[-1]
    return laid


def _above(field: Field, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """The points, raised to the tissue's surface where they are below it."""
    lowest = _floor(field.surface, points) - field.radius_m
    return np.column_stack((points[:, :2], np.minimum(points[:, 2], lowest)))


def _fallen(field: Field, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    rest = _floor(field.surface, points) - field.height_m
    return np.column_stack((points[:, :2], np.maximum(points[:, 2], rest)))


def _floor(surface: Surface, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
    """Depth of the tissue beneath points."""
    return MM * depth_at_points(surface, points[:, :2] / MM)


def _fitted(field: Field, points: Float64[np.ndarray, "n 3"]) -> Field:
    """The field with the spline nearest to the points as its thread."""
    control = fitted_control_points(field.length_m)
    basis = fitting_basis(control)
    control_points = np.linalg.solve(basis.T @ basis, basis.T @ points)
    knots = clamped_uniform_knots(control, DEGREE)
    return replace(field, knots=knots, control_points=control_points, points=basis @ control_points)


def fitted_control_points(length_m: float) -> int:
    """How many control points the spline of a thread that has moved has."""
    return max(round(length_m / CONTROL_SPACING_M), 1) + DEGREE


@lru_cache(maxsize=16)
def fitting_basis(control_points: int) -> Float64[np.ndarray, "n m"]:
    """From control points of a clamped uniform spline to the SAMPLES places along it."""
    knots = clamped_uniform_knots(control_points, DEGREE)
    return basis_matrix(knots, DEGREE, np.linspace(0.0, 1.0, SAMPLES))


def starting_first(camera: RectifiedStereo, thread: Thread) -> Thread:
    """The thread from the end with the smaller u in the left image, by which the project counts s (ties: smaller v)."""
    ends, _ = project(camera, thread.control_points[[0, -1]])
    if tuple(ends[0]) <= tuple(ends[1]):
        return thread
    return replace(thread, knots=1.0 - thread.knots[::-1], control_points=thread.control_points[::-1].copy())
