"""A reconstructed thread as what can be drawn: points that are evenly spaced along it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from schemas.messages import Status, ThreadReconstruction
from shared import arc_length, splines

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
        parameter = _even_parameters(knots, control, degree, count)
        points = splines.evaluate(knots, control, degree, parameter)
    if not (np.isfinite(points).all() and (points[:, 2] > 0).all()):
        return None
    if np.ptp(points, axis=0).max() <= SMALLEST_EXTENT * np.abs(points).max():
        return None
    along = np.linspace(0.0, 1.0, count)
    return Polyline(
        points_camera=points,
        parameter=parameter,
        along=along,
        confidence=_confidence_at(reconstruction, along),
        unseen=_unseen_at(reconstruction, along),
        length=length,
    )


def _even_parameters(
    knots: Float64[np.ndarray, "k"], control: Float64[np.ndarray, "m 3"], degree: int, count: int
) -> Float64[np.ndarray, "n"]:
    """Parameters of points that are evenly spaced, as exactly as can be seen: the exact ones take ten times as long."""
    breaks = np.unique(knots)
    spans = len(breaks) - 1
    s = np.interp(np.arange(CHORDS_PER_SPAN * spans + 1) / CHORDS_PER_SPAN, np.arange(spans + 1), breaks)
    # huge numbers overflow when they are squared
    points = splines.evaluate(knots, control / (np.abs(control).max() or 1.0), degree, s)
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    lengths = np.concatenate(([0.0], np.cumsum(chords)))
    return np.interp(np.linspace(0.0, lengths[-1], count), lengths, s)


def along_at(thread: Polyline, parameter: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """Where parameters of the spline sit along the thread, as the share of its length before each."""
    return np.interp(parameter, thread.parameter, thread.along)


def at_shares(
    thread: Polyline, along: Float64[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """Confidence, and whether not both images show the thread, at shares of its length."""
    nearest = np.rint(along * (len(thread.along) - 1)).astype(int)
    return np.interp(along, thread.along, thread.confidence), thread.unseen[nearest]


def _confidence_at(reconstruction: ThreadReconstruction, along: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    if len(reconstruction.confidence) == 0:
        return np.full(len(along), np.nan)
    order = np.argsort(reconstruction.confidence_s)
    return np.interp(along, reconstruction.confidence_s[order], reconstruction.confidence[order])


def _unseen_at(reconstruction: ThreadReconstruction, along: Float64[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    begins, ends = reconstruction.unseen[:, :1], reconstruction.unseen[:, 1:]
    return np.logical_or.reduce((begins <= along) & (along <= ends), axis=0)
