"""A track as the message that tells it, and the track again from that message: nothing else is remembered of it."""

from typing import Any

import numpy as np

from agents.tool_tracker.correction import Correction
from agents.tool_tracker.refinement import Refined, View
from agents.tool_tracker.track import Candidate, Following, Track
from schemas.messages import FrameStamp, ToolCandidate, ToolCorrection, ToolStatus
from shared.kinematics.psm import FINGER_M
from shared.rigid_transforms import apply, log_so3

TIP = np.array([[0.0, 0.0, FINGER_M]])
STATUSES = {
    Following.SEARCHING: ToolStatus.CONVERGING,
    Following.FOLLOWED: ToolStatus.CONVERGED,
    Following.LOST: ToolStatus.LOST,
}
FOLLOWINGS = {status: following for following, status in STATUSES.items()}
NONE_PX = np.zeros((0, 2))


def told_of(arm: str, stamp: FrameStamp, measured_ns: int, track: Track, view: View) -> ToolCorrection:
    """What a view has made of an arm's track."""
    registered, _ = view.expected(np.eye(4))
    return ToolCorrection(
        arm=arm,
        stamp=stamp,
        measured_ns=measured_ns,
        status=STATUSES[track.state],
        reason=track.reason,
        pivot_camera=track.pivot,
        registered_left_px=registered.px,
        candidates=_candidates(track),
        attempts=track.attempts,
        misses=track.misses,
        looks=track.views,
        **_corrected(track, view),
    )


def track_of(told: ToolCorrection) -> Track:
    """The track that a message tells."""
    candidates = tuple(_candidate(one, told) for one in told.candidates)
    state = FOLLOWINGS[told.status]
    if state is not Following.FOLLOWED:
        return Track(
            told.pivot_camera, state, told.reason, candidates=candidates, attempts=told.attempts, views=told.looks
        )
    found = candidates[0].found
    return Track(
        told.pivot_camera,
        state,
        told.reason,
        found.correction,
        found,
        candidates[0].table,
        misses=told.misses,
        views=told.looks,
    )


def _corrected(track: Track, view: View) -> dict[str, Any]:
    """Fields about the correction, where it may be used."""
    before = apply(view.T_camera_base @ view.T_base_tool, TIP)[0]
    names = ("tip_off_m", "turned_rad", "tip_deviation_m", "turn_deviation_rad")
    correction = track.correction
    if not track.consistent or correction is None:
        return {
            "T_correction": None,
            "tip_camera": before,
            **dict.fromkeys(names, 0.0),
            "found_left_px": NONE_PX,
            "found_right_px": NONE_PX,
        }
    C = correction.matrix
    tip = apply(C, before[None])[0]
    left, right = view.expected(C)
    figures = (
        float(np.linalg.norm(tip - before)),
        float(np.linalg.norm(log_so3(C[:3, :3]))),
        float(np.sqrt(np.trace(correction.point_covariance(tip)))),
        float(np.sqrt(np.trace(correction.covariance[3:, 3:]))),
    )
    return {
        "T_correction": C,
        "tip_camera": tip,
        **dict(zip(names, figures, strict=True)),
        "found_left_px": left.px,
        "found_right_px": right.px,
    }


def _candidates(track: Track) -> tuple[ToolCandidate, ...]:
    if track.state is Following.FOLLOWED and track.correction is not None and track.refined is not None:
        return (_told(track.correction, track.refined, track.table),)
    return tuple(_told(one.found.correction, one.found, one.table) for one in track.candidates)


def _told(correction: Correction, found: Refined, table: Any) -> ToolCandidate:
    return ToolCandidate(
        twist=correction.twist,
        covariance=correction.covariance,
        table=np.rint(255 * table).astype(np.uint8),
        expected=found.expected,
        fits=found.fits,
        quality=found.quality,
        residual_px=found.residual_px if np.isfinite(found.residual_px) else 0.0,
    )


def _candidate(told: ToolCandidate, of: ToolCorrection) -> Candidate:
    correction = Correction(told.twist, told.covariance, of.pivot_camera)
    found = Refined(correction, told.expected, told.fits, told.quality, told.residual_px, 0.0)
    return Candidate(found, told.table.astype(np.float32) / 255)
