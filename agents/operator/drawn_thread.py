"""The thread as the page draws it, as plain numbers: evenly spaced places with their confidence, and crossings.

Places are projected into the rectified left image (pixels) and told in the camera frame too (mm), for the view in
space.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from agents.operator.compact import compact, packed
from schemas.messages import RectifiedStereo, Status, ThreadReconstruction
from shared import splines
from shared.camera import project

PLACES = 201
"""Along the thread: a place every few pixels."""
CHORDS = 600
"""At least so many make up the length of a thread, to 0.01 %: it is drawn with every frame, and shared.arc_length takes
seven times as long."""
MM = 1e3
FARTHEST_PX = 20_000.0


@dataclass(frozen=True)
class DrawnThread:
    """The thread of one frame as evenly spaced places.

    Fields:
        px: of the rectified left image; along: s of each.
        points_mm: in the camera frame; in the calibration's own unit where nobody knows what that is.
        confidence: NaN where none is stated.
        unseen: not both images show it.
        to_mm: what takes the calibration's unit to mm; None where it is unknown.
        found: the how many-th that was found anew; s names places on those of the same number alone.
    """

    frame: int
    capture_ns: int
    camera: RectifiedStereo
    px: Float64[np.ndarray, "n 2"]
    points_mm: Float64[np.ndarray, "n 3"]
    along: Float64[np.ndarray, "n"]
    confidence: Float64[np.ndarray, "n"]
    unseen: Bool[np.ndarray, "n"]
    length_mm: float
    to_mm: float | None
    crossings: tuple[dict[str, Any], ...]
    elsewhere: tuple[tuple[float, float], ...] = ()
    found: int = 0

    @cached_property
    def told(self) -> str:
        """For every page the same, as JSON."""
        return compact(self.document())

    def document(self) -> dict[str, Any]:
        """For the page; what there is of each place is packed."""
        known = np.where(np.isfinite(self.confidence), self.confidence, -1.0)
        return {
            "frame": self.frame,
            "capture_ms": self.capture_ns * 1e-6,
            "px": packed(self.px),
            "mm": packed(self.points_mm),
            "confidence": packed(known),
            "unseen": packed(self.unseen.astype(float)),
            "length_mm": round(self.length_mm, 2),
            "unit_known": self.to_mm is not None,
            "crossings": list(self.crossings),
            "elsewhere": [list(leads) for leads in self.elsewhere],
        }


def millimetres(camera: RectifiedStereo) -> float | None:
    """What takes the calibration's unit to mm."""
    return None if camera.metres_per_unit is None else MM * camera.metres_per_unit


def draw_thread(thread: ThreadReconstruction) -> DrawnThread | None:
    """The thread of a reconstruction; None where it failed, or is no curve before the camera."""
    if thread.status is Status.FAILED:
        return None
    knots, control, degree = thread.knots, thread.control_points_camera, thread.degree
    with np.errstate(all="ignore"):
        points, length = evenly(knots, control, degree, PLACES)
        if not (np.isfinite(points).all() and np.isfinite(length) and (points[:, 2] > 0).all()):
            return None
        px, _ = project(thread.camera, points)
    along, to_mm = np.linspace(0.0, 1.0, PLACES), millimetres(thread.camera)
    order = np.argsort(thread.confidence_s)
    stated = len(order) > 0
    confidence = (
        np.interp(along, thread.confidence_s[order], thread.confidence[order]) if stated else np.full(PLACES, np.nan)
    )
    begins, ends = thread.unseen[:, :1], thread.unseen[:, 1:]
    crossings = tuple(
        {
            "px": [round(float(v), 1) for v in crossing.point_px],
            "s": [round(crossing.s_first, 3), round(crossing.s_second, 3)],
            "over": crossing.over.name.lower(),
        }
        for crossing in thread.crossings
    )
    return DrawnThread(
        frame=thread.stamp.sequence,
        capture_ns=min(thread.stamp.capture_left_ns, thread.stamp.capture_right_ns),
        camera=thread.camera,
        px=np.clip(px, -FARTHEST_PX, FARTHEST_PX),
        points_mm=points * (to_mm or 1.0),
        along=along,
        confidence=confidence,
        unseen=np.logical_or.reduce((begins <= along) & (along <= ends), axis=0) if len(begins) else along < 0,
        length_mm=length * (to_mm or 1.0),
        to_mm=to_mm,
        crossings=crossings,
        elsewhere=()
        if thread.course is None
        else tuple((round(float(a), 3), round(float(b), 3)) for a, b in thread.course.elsewhere),
    )


def evenly(
    knots: Float64[np.ndarray, "k"], control_points: Float64[np.ndarray, "m d"], degree: int, count: int
) -> tuple[Float64[np.ndarray, "n d"], float]:
    """Points of a curve, evenly spaced along it, and its length by chords, in the unit of the control points."""
    breaks = np.unique(knots)
    per_span = -(-CHORDS // max(1, len(breaks) - 1))
    cuts = np.interp(np.arange(per_span * (len(breaks) - 1) + 1) / per_span, np.arange(len(breaks)), breaks)
    chords = np.linalg.norm(np.diff(splines.evaluate(knots, control_points, degree, cuts), axis=0), axis=1)
    lengths = np.concatenate(([0.0], np.cumsum(chords)))
    parameters = np.interp(np.linspace(0.0, lengths[-1], count), lengths, cuts)
    return splines.evaluate(knots, control_points, degree, parameters), float(lengths[-1])
