"""A reconstructed thread as what can be drawn: evenly spaced points, and what is known at each of them.

Where the thread lies with 95 % probability: ellipses in the planes across it, a tube along it. With C the posterior
covariance of a point and N two unit vectors across the thread, Σ = Nᵀ C N is the covariance within the plane. Its
ellipse of 95 % is √5.991 Σ^½ (cos φ, sin φ), and the largest eigenvalue of Σ is the variance in the worst direction.
What is unknown along the thread moves no point off it, and does not count.

Residuals: how far the middle of the thread, as an image shows it, lies from the projected curve. A point is compared
with the nearest place of the curve, so one that takes a wrong turn at a crossing may still have small residuals; which
of two strands a point belongs to is not asked.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from schemas.messages import Centrelines, Status, ThreadObservations, ThreadReconstruction
from shared import arc_length
from shared.along_thread import confidence_at, nearly_even, unseen_at
from shared.camera import project
from shared.curve_distance import CHI_SQUARE_95, nearest_on_polyline
from shared.splines import evaluate

MANY_POINTS = 400
"""Segments of the polyline are below two pixels for a thread that spans the image once."""

CHORDS_PER_SPAN = 24
"""Pieces of each knot span whose lengths are taken as those of their chords."""

SMALLEST_EXTENT = 1e-9
"""A thread that spans less than this share of its distance is a point, but for rounding."""


@dataclass(frozen=True)
class Polyline:
    """Points along a thread, in front of the camera.

    Fields:
        parameter: the spline's parameter at each point.
        along: the share of the whole length that lies before each point, 0 to 1.
        confidence: NaN where it is unknown.
        length: of the whole thread, in the calibration's unit.
    """

    points_camera: Float64[np.ndarray, "n 3"]
    parameter: Float64[np.ndarray, "n"]
    along: Float64[np.ndarray, "n"]
    confidence: Float64[np.ndarray, "n"]
    unseen: Bool[np.ndarray, "n"]
    length: float


def thread_polyline(reconstruction: ThreadReconstruction, count: int = MANY_POINTS) -> Polyline | None:
    """The thread of a reconstruction as a polyline, None where it failed or is no curve before the camera."""
    knots, control, degree = reconstruction.knots, reconstruction.control_points_camera, reconstruction.degree
    if reconstruction.status is Status.FAILED:
        return None
    with np.errstate(all="ignore"):
        length = arc_length.length(knots, control, degree)
        if not np.isfinite(length):
            return None
        parameter, _ = nearly_even(knots, control, degree, count, CHORDS_PER_SPAN)
        points = evaluate(knots, control, degree, parameter)
    if not (np.isfinite(points).all() and (points[:, 2] > 0).all()):
        return None
    if np.ptp(points, axis=0).max() <= SMALLEST_EXTENT * np.abs(points).max():
        return None
    along = np.linspace(0.0, 1.0, count)
    return Polyline(
        points_camera=points,
        parameter=parameter,
        along=along,
        confidence=confidence_at(reconstruction, along),
        unseen=unseen_at(reconstruction, along),
        length=length,
    )


def along_at(thread: Polyline, parameter: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """Where parameters of the spline sit along the thread, as the share of its length before each."""
    return np.interp(parameter, thread.parameter, thread.along)


def at_shares(
    thread: Polyline, along: Float64[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """Confidence, and whether not both images show the thread, at shares of its length."""
    nearest = np.rint(along * (len(thread.along) - 1)).astype(int)
    return np.interp(along, thread.along, thread.confidence), thread.unseen[nearest]


CORNERS = 12
"""Of a ring about the thread."""
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class CrossSections:
    """What is predicted across the thread at places along it, none where the method predicts nothing.

    Fields:
        along: which share of the length lies before each place.
        deviation: standard deviation across the thread in its worst direction, in the unit of the calibration.
        rings_camera: the ellipse of 95 % as corners of a closed line; corners of one number lie beside each other.
        confidence, unseen: of the thread there.
    """

    along: Float64[np.ndarray, "q"]
    deviation: Float64[np.ndarray, "q"]
    rings_camera: Float64[np.ndarray, "q k 3"]
    confidence: Float64[np.ndarray, "q"]
    unseen: Bool[np.ndarray, "q"]


def cross_sections(reconstruction: ThreadReconstruction, thread: Polyline | None) -> CrossSections:
    """The cross-sections where the posterior is given, in order along the thread."""
    empty = np.zeros(0)
    if thread is None or not len(reconstruction.posterior_s):
        return CrossSections(empty, empty, np.zeros((0, CORNERS, 3)), empty, np.zeros(0, bool))
    order = np.argsort(reconstruction.posterior_s)
    s, covariance = reconstruction.posterior_s[order], reconstruction.posterior_covariance[order]
    curve = reconstruction.knots, reconstruction.control_points_camera, reconstruction.degree
    with np.errstate(all="ignore"):
        across = _across(evaluate(*curve, s, derivative=1))
        within = np.einsum("qai,qab,qbj->qij", across, covariance, across)
        deviation, root = _deviation_and_root(within)
        angle = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
        circle = np.sqrt(CHI_SQUARE_95) * np.stack((np.cos(angle), np.sin(angle)))
        rings = evaluate(*curve, s)[:, None] + np.moveaxis(across @ root @ circle, 2, 1)
    known = np.isfinite(rings).all(axis=(1, 2)) & np.isfinite(deviation)
    along = along_at(thread, s[known])
    confidence, unseen = at_shares(thread, along)
    return CrossSections(along, deviation[known], rings[known], confidence, unseen)


@functools.cache
def tube_triangles(rings: int) -> Int64[np.ndarray, "t 3"]:
    """The corners of the triangles between neighbouring rings, with the corners of all rings numbered one by one."""
    corner = np.arange(CORNERS)
    beside = (corner + 1) % CORNERS
    one = np.concatenate(
        (np.stack((corner, beside, corner + CORNERS), 1), np.stack((beside, beside + CORNERS, corner + CORNERS), 1))
    )
    return (one + CORNERS * np.arange(max(rings - 1, 0))[:, None, None]).reshape(-1, 3)


def _across(tangent: Float64[np.ndarray, "q 3"]) -> Float64[np.ndarray, "q 3 2"]:
    """Two unit vectors across the thread at each place, turned as little as can be from one place to the next."""
    t = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), TINY)
    beside = np.eye(3)[np.argmin(np.abs(t[0]))].tolist()
    rows: list[list[float]] = []
    # one place follows from the one before it, where plain numbers take a tenth of the time of small arrays
    for x, y, z in t.tolist():
        u, v, w = beside
        along = u * x + v * y + w * z
        u, v, w = u - along * x, v - along * y, w - along * z
        size = max(math.sqrt(u * u + v * v + w * w), TINY)
        beside = [u / size, v / size, w / size]
        rows.append(beside)
    first = np.array(rows).reshape(t.shape)
    return np.stack((first, np.cross(t, first)), axis=2)


def _deviation_and_root(
    covariance: Float64[np.ndarray, "q 2 2"],
) -> tuple[Float64[np.ndarray, "q"], Float64[np.ndarray, "q 2 2"]]:
    """The root of the largest eigenvalue, and the symmetric root Σ^½ = (Σ + √|Σ| I) / √(tr Σ + 2 √|Σ|)."""
    a, b, d = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    largest = 0.5 * (a + d) + np.hypot(0.5 * (a - d), b)
    product = np.sqrt(np.maximum(a * d - b * b, 0.0))
    norm = np.sqrt(np.maximum(a + d + 2.0 * product, TINY))
    root = (covariance + product[:, None, None] * np.eye(2)) / norm[:, None, None]
    return np.sqrt(np.maximum(largest, 0.0)), root


EDGE = 0.5
"""A curve that lies this many widths of the thread beside its middle runs along the thread's edge."""

CLAIMED = 1.0
"""Points within this many widths of the curve are its own; what lies farther out is something else, or left over."""


EXAGGERATION = 20
LONGEST_WHISKER_PX = 40.0

UNSEEN_PLACE = 1e6
"""Where the nearest place of a curve that is nowhere is put: far out of any image."""


@dataclass(frozen=True)
class Residuals:
    """The points of one image's centrelines beside the projected curve.

    Fields:
        point_px, foot_px: each point, and the place of the projected curve that is nearest to it.
        along: which share of the thread's length lies before that place.
        distance_px: between both.
        widths: the same as a multiple of the thread's apparent width there.
    """

    point_px: Float64[np.ndarray, "n 2"]
    foot_px: Float64[np.ndarray, "n 2"]
    along: Float64[np.ndarray, "n"]
    distance_px: Float64[np.ndarray, "n"]
    widths: Float64[np.ndarray, "n"]

    @property
    def claimed(self) -> Bool[np.ndarray, "n"]:
        """Which points the curve explains."""
        return self.widths <= CLAIMED

    def every(self, step: int) -> "Residuals":
        """The first of every so many points."""
        of = slice(None, None, step)
        return Residuals(self.point_px[of], self.foot_px[of], self.along[of], self.distance_px[of], self.widths[of])


@dataclass(frozen=True)
class ResidualSummary:
    """Of the points that the curve explains, in pixels, and the share that it does not; None where there are none."""

    median_px: float | None
    percentile_95_px: float | None
    left_over: float | None


def residuals(centrelines: Centrelines, thread: Polyline, thread_px: Float64[np.ndarray, "m 2"]) -> Residuals:
    """Compare the points of an image with the thread, whose polyline projects to `thread_px` there."""
    point = centrelines.point_px
    foot, along = _feet(point, thread_px, thread.along)
    distance = np.hypot(*(point - foot).T)
    return Residuals(point, foot, along, distance, distance / centrelines.width_px)


def both_residuals(observations: ThreadObservations, thread: Polyline) -> tuple[Residuals, Residuals]:
    """Compare the points of the left and of the right image with the thread."""
    left_px, right_px = project(observations.camera, thread.points_camera)
    left, right = observations.centrelines_left, observations.centrelines_right
    return residuals(left, thread, left_px), residuals(right, thread, right_px)


def summary(found: Residuals) -> ResidualSummary:
    """The residuals in three numbers."""
    if not len(found.distance_px):
        return ResidualSummary(None, None, None)
    own = found.distance_px[found.claimed]
    left_over = 1.0 - len(own) / len(found.distance_px)
    if not len(own):
        return ResidualSummary(None, None, left_over)
    median, percentile_95 = np.percentile(own, (50, 95)).tolist()
    return ResidualSummary(median, percentile_95, left_over)


def whiskers(found: Residuals) -> Float64[np.ndarray, "n 2 2"]:
    """A line for each point, from the curve toward it: the residual many times exaggerated, up to a longest one."""
    length = np.minimum(EXAGGERATION * found.distance_px, LONGEST_WHISKER_PX)
    scale = np.divide(length, found.distance_px, out=np.zeros(len(length)), where=found.distance_px > 0)
    return np.stack((found.foot_px, found.foot_px + scale[:, None] * (found.point_px - found.foot_px)), axis=1)


def closeness(found: Residuals) -> Float64[np.ndarray, "n"]:
    """1 where the curve runs through the middle of the thread, 0 at its edge and beyond."""
    return 1.0 - np.minimum(found.widths / EDGE, 1.0)


def _feet(
    point: Float64[np.ndarray, "n 2"], line: Float64[np.ndarray, "m 2"], along: Float64[np.ndarray, "m"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n"]]:
    """The nearest places of a polyline, and the shares of its length before them."""
    inside = np.isfinite(line).all(axis=1)
    if not len(point) or inside.sum() < 2:
        return np.full(point.shape, UNSEEN_PLACE), np.zeros(len(point))
    foot, at = nearest_on_polyline(point, line[inside])
    return foot, np.interp(at, np.arange(inside.sum()), along[inside])
