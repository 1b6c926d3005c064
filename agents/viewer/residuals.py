"""How far the middle of the thread, as an image shows it, lies from the projected curve.

A point is compared with the nearest place of the projected curve, so a curve that takes a wrong turn at a crossing may
still have small residuals; which of two strands a point belongs to is not asked.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import KDTree

from agents.viewer.polyline import Polyline
from schemas.messages import Centrelines, ThreadObservations
from shared.camera import project

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
    """The nearest places of a polyline: on the two pieces of it that meet in the nearest corner."""
    inside = np.isfinite(line).all(axis=1)
    if not len(point) or inside.sum() < 2:
        return np.full(point.shape, UNSEEN_PLACE), np.zeros(len(point))
    line, along = line[inside], along[inside]
    corner = np.asarray(KDTree(line).query(point)[1])
    feet = [_foot_on_piece(point, line, along, np.clip(corner - k, 0, len(line) - 2)) for k in (1, 0)]
    (foot, at, squared), (other, other_at, other_squared) = feet
    nearer = squared <= other_squared
    return np.where(nearer[:, None], foot, other), np.where(nearer, at, other_at)


def _foot_on_piece(
    point: Float64[np.ndarray, "n 2"],
    line: Float64[np.ndarray, "m 2"],
    along: Float64[np.ndarray, "m"],
    piece: np.ndarray,
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    start, step = line[piece], line[piece + 1] - line[piece]
    squared = np.einsum("ij,ij->i", step, step)
    share = np.divide(np.einsum("ij,ij->i", point - start, step), squared, out=np.zeros(len(point)), where=squared > 0)
    share = np.clip(share, 0.0, 1.0)
    foot = start + share[:, None] * step
    off = point - foot
    return foot, along[piece] + share * (along[piece + 1] - along[piece]), np.einsum("ij,ij->i", off, off)
