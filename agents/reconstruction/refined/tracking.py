"""Following the thread from frame to frame: the last posterior, with process noise, is the prior of the next frame.

`following` goes on from the last curve where the innovation test allows it. Where it does not, the track is begun anew
from the frame alone, and the message says why. So it is where that, tried once a second, explains the images better, or
as well with a curve that lies where the one that was followed claims not to be, and claims less itself: a wrong course,
or a wrong smoothness, that was followed once would otherwise be followed for ever, and be believed.

The curve keeps its direction and, as thread does not stretch, its length: what is hidden stays part of it, unseen, and
an end counts only where the length stays. So a place s is the same piece of thread in every frame, as far as images can
tell: how far a thread slides along itself shows at its ends alone. When a track is begun anew, `material_s` says which
places its ends are on the scale of the curve before.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from agents.reconstruction.paper import failed
from agents.reconstruction.refined.following import Followed, LostError, band_of, curve_length, followed
from agents.reconstruction.refined.method import (
    METHOD,
    NoCurveError,
    course_and_fit,
    need_evidence,
    regions_along,
    seen_enough,
    told_course,
    uncertain,
)
from agents.reconstruction.refined.plausibility import is_usable_track, unusable
from agents.reconstruction.refined.posterior import ALIKE, LEAST, point_covariance
from agents.reconstruction.refined.projection import Curve, pixels_evenly
from agents.reconstruction.refined.refinement import Refined
from agents.reconstruction.refined.result import reconstruction, starts_right
from schemas.messages import (
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    ThreadCourse,
    ThreadObservations,
    ThreadReconstruction,
    ThreadTrack,
    TrackStep,
)

VERIFY_S, VERIFY_FRAMES = 1.0, 30
"""A frame is also reconstructed alone so often, or once in so many frames where they come faster."""
DOUBTED_FRAMES = 5
"""Where the curve leaves thread unexplained, once in so many: a frame alone takes as long as three tracked ones."""
OUTSIDE, MOST_OUTSIDE = 9.21, 0.1
"""The square of the distance, in deviations of a normal distribution in the plane, beyond which 1 % lies; of a curve no
more than that share may lie so far from the one that its frame shows alone."""
LONGEST_S = 0.5
"""A curve that is older is no prediction."""
KEPT_S = 10.0
"""As long as that, direction and scale of a lost track are kept for the one that begins anew."""
EXPLAINED_PX_SHARE, BETTER = 0.003, 0.04
PLACES_OF_SPAN = 8
SAME_THREAD_SHARE = 0.05
"""Of the length: places of two curves that are nearer may be the same piece of thread."""
SAME_LENGTH = 0.03


@dataclass(frozen=True)
class _Alone:
    """What a frame says by itself, in the direction that is kept."""

    fit: Refined
    regions: ReliabilityRegions
    reverse: bool
    course: ThreadCourse


def track_refined(observations: ThreadObservations, last: ThreadReconstruction | None) -> ThreadReconstruction:
    """The thread of this frame, with the last reconstruction in mind; without any, that of the frame alone.

    Never raises for any valid observations: a failure is a status with its reason, and keeps the track in mind.
    """
    before = last.track if last is not None and last.camera == observations.camera else None
    if before is not None and not is_usable_track(before, observations.camera):
        before = None
    if observations.status is not Status.OK:
        return _lost(observations, observations.reason, before)
    reason = ""
    if before is not None:
        try:
            return _continued(observations, before, last and last.course)
        except LostError as error:
            reason = str(error)
    try:
        need_evidence(observations)
        return _begun(observations, _alone(observations, before), before, reason)
    except NoCurveError as error:
        return _lost(observations, str(error), before)


def _continued(
    observations: ThreadObservations, before: ThreadTrack, course: ThreadCourse | None
) -> ThreadReconstruction:
    lines = observations.centrelines_left, observations.centrelines_right
    if reason := unusable(*lines, observations.camera):
        raise LostError(reason)
    elapsed_s = _since(observations, before)
    if not 0 <= elapsed_s <= LONGEST_S:
        raise LostError(f"the last curve is of {elapsed_s:.1f} s ago")
    now = followed(before, lines, observations.camera, elapsed_s, uncertain(observations))
    if before.step is TrackStep.LOST or _is_due(before, elapsed_s, now.found_share):
        alone = _verified(observations, before, now)
        course = course if alone is None else _course_along(now.fit.curve, alone)
    no_regions = ReliabilityRegions(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    track = replace(
        before,
        step=TrackStep.CONTINUED,
        reason="",
        frames=before.frames + 1,
        innovation=now.innovation,
        found_share=now.found_share,
        stamp=observations.stamp,
        control_points_camera=now.fit.curve.control_points,
        covariance=ALIKE * band_of(now.fit.covariance),
        smoothing=now.fit.smoothing,
        span_weight=now.fit.weight,
        velocity_camera=_velocity(before.control_points_camera, now.fit.curve.control_points, elapsed_s),
    )
    return reconstruction(observations, METHOD, now.fit, no_regions, reverse=False, course=course, track=track)


def _velocity(
    then: Float64[np.ndarray, "m 3"], now: Float64[np.ndarray, "m 3"], elapsed_s: float
) -> Float64[np.ndarray, "m 3"] | None:
    return (now - then) / elapsed_s if elapsed_s > 0 else None


def _course_along(curve: Curve, alone: _Alone) -> ThreadCourse:
    """The course of the frame alone, at the places of a curve that runs the same way."""
    at = np.linspace(0.0, 1.0, 401)
    there = alone.fit.curve.at(at[:: -1 if alone.reverse else 1])
    s = np.maximum.accumulate(_nearest(curve.at(at), there)[1]) / (len(at) - 1)
    return replace(alone.course, joins=np.interp(alone.course.joins, at, s), other=np.interp(alone.course.other, at, s))


def _begun(
    observations: ThreadObservations, alone: _Alone, before: ThreadTrack | None, reason: str
) -> ThreadReconstruction:
    track = _track(alone.fit, observations, alone.reverse)
    if before is not None:
        track = replace(track, step=TrackStep.RESTARTED, reason=reason)
        if _is_kept(observations, before):
            material_s, scale = _material(before, track)
            track = replace(track, material_s=material_s, length=scale)
    return seen_enough(
        reconstruction(observations, METHOD, alone.fit, alone.regions, alone.reverse, alone.course, track)
    )


def _lost(observations: ThreadObservations, reason: str, before: ThreadTrack | None) -> ThreadReconstruction:
    track = before and replace(
        before, step=TrackStep.LOST, reason=reason, frames=before.frames + 1, innovation=0.0, found_share=0.0
    )
    return replace(failed(observations, METHOD, reason), track=track)


def _alone(observations: ThreadObservations, before: ThreadTrack | None) -> _Alone:
    course, fit = course_and_fit(observations)
    if before is None or not _is_kept(observations, before):
        reverse = starts_right(fit.curve, observations)
    else:
        reverse = _runs_against(fit.curve, before)
    regions = regions_along(fit, course, observations.camera)
    return _Alone(fit, regions, reverse, told_course(course, fit, reverse))


def _runs_against(curve: Curve, before: ThreadTrack) -> bool:
    """Whether a new curve's first end is the last one of the track.

    Where most of it lies on the last curve, that one's directions tell; a thread that was laid elsewhere keeps the
    direction in which less of it has moved.
    """
    at = np.linspace(0.0, 1.0, 201)
    then, now = Curve(before.knots, before.control_points_camera).at(at), curve.at(at)
    distance, nearest = _nearest(then, now)
    same = distance < SAME_THREAD_SHARE * before.length
    if same.mean() > 0.5:
        agree = (np.gradient(then, axis=0)[nearest[same]] * np.gradient(now, axis=0)[same]).sum()
        return bool(agree < 0)
    return bool(np.linalg.norm(now[::-1] - then, axis=1).sum() < np.linalg.norm(now - then, axis=1).sum())


def _is_kept(observations: ThreadObservations, before: ThreadTrack) -> bool:
    return 0 <= _since(observations, before) <= KEPT_S


def _since(observations: ThreadObservations, before: ThreadTrack) -> float:
    return (observations.stamp.capture_left_ns - before.stamp.capture_left_ns) * 1e-9


def _track(fit: Refined, observations: ThreadObservations, reverse: bool) -> ThreadTrack:
    """A track that begins with this fit."""
    way = slice(None, None, -1 if reverse else 1)
    curve = fit.curve.moved(np.zeros(3)) if not reverse else Curve(fit.curve.knots, fit.curve.control_points[::-1])
    band = ALIKE * band_of(fit.covariance)
    return ThreadTrack(
        step=TrackStep.STARTED,
        reason="",
        frames=0,
        innovation=0.0,
        found_share=1.0,
        stamp=observations.stamp,
        knots=curve.knots,
        control_points_camera=curve.control_points.copy(),
        covariance=_turned(band) if reverse else band,
        smoothing=fit.smoothing,
        span_weight=fit.weight[way].copy(),
        row_offset_px=float(fit.row_offset_px[0]),
        row_slopes_px=fit.row_offset_px[1:] if fit.row_offset_px[1:].any() else None,
        length=curve_length(curve),
        material_s=np.array([0.0, 1.0]),
    )


def _turned(band: Float64[np.ndarray, "m 4 3 3"]) -> Float64[np.ndarray, "m 4 3 3"]:
    """The covariance of the control points in reverse order."""
    turned, m = np.zeros_like(band), len(band)
    for offset in range(band.shape[1]):
        i = np.arange(m - offset)
        turned[i, offset] = band[m - 1 - offset - i, offset].transpose(0, 2, 1)
    return turned


def _material(before: ThreadTrack, track: ThreadTrack) -> tuple[Float64[np.ndarray, "2"], float]:
    """Which places the ends of a new curve are on the scale of the old one, and that scale's length."""
    at, scale = np.linspace(0.0, 1.0, 201), float(np.diff(before.material_s)[0])
    then = Curve(before.knots, before.control_points_camera).at(at)
    distance, nearest = _nearest(Curve(track.knots, track.control_points_camera).at(at), then)
    share = track.length / before.length
    if abs(share / scale - 1.0) < SAME_LENGTH:
        return before.material_s, before.length
    same = (distance < SAME_THREAD_SHARE * before.length) & (nearest > 0) & (nearest < len(at) - 1)
    if same.mean() < 0.5 * min(1.0, share / scale):
        return np.array([0.0, 1.0]), track.length
    start = float(np.median(before.material_s[0] + scale * at[same] - share * at[nearest[same]]))
    return np.array([start, start + share]), before.length


def _is_due(before: ThreadTrack, elapsed_s: float, found_share: float) -> bool:
    every = min(VERIFY_FRAMES, max(1, round(VERIFY_S / max(elapsed_s, 1e-3))))
    if found_share < 1.0 - BETTER:
        # so much is left over that the frame alone may explain it better
        every = min(every, DOUBTED_FRAMES)
    return before.frames % every == every - 1


def _verified(observations: ThreadObservations, before: ThreadTrack, now: Followed) -> _Alone | None:
    """What the frame shows alone; None where it shows no curve.

    Behind a tool a frame alone may fail where the track need not; with the thread in view it contradicts the track.

    Raises:
        LostError: where the frame alone shows a curve that explains both images better, or shows none.
    """
    try:
        alone = _alone(observations, before)
    except NoCurveError as error:
        if now.hidden_alike:
            return None
        raise LostError(f"the frame alone shows no thread: {error}") from error
    here, there = _explained(observations, now.fit), _explained(observations, alone.fit)
    if there > here + BETTER:
        raise LostError(
            f"begun anew, the curve explains {there:.0%} of both images' thread, and {here:.0%} as followed"
        )
    at = np.linspace(0.0, 1.0, 201)
    order = _nearest(now.fit.curve.at(at), alone.fit.curve.at(at))[1]
    falls = float((np.diff(order[:: -1 if alone.reverse else 1]) < -10).mean())
    if falls > 0 and there >= here:
        raise LostError("begun anew, the curve takes another course")
    outside = _claimed_too_much(now.fit, alone.fit, observations.camera)
    if outside > MOST_OUTSIDE and there > here - BETTER:
        raise LostError(
            f"begun anew, {outside:.0%} of the curve lies farther away than the followed one was said to be off at most"
        )
    return alone


def _claimed_too_much(followed_fit: Refined, alone: Refined, camera: RectifiedStereo) -> float:
    """The share of a curve that excludes the one of the frame alone, where that one itself is less sure.

    Both rest on the same points there, so what makes them differ is only believed: how smooth the thread is, and where
    it was before.
    """
    at = np.linspace(0.0, 1.0, 101)
    here, there = followed_fit.curve.at(at), alone.curve.at(at)
    _, nearest = _nearest(there, here)
    tangent = np.gradient(here, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), LEAST)
    off = there[nearest] - here
    off -= (off * tangent).sum(axis=1, keepdims=True) * tangent
    across = np.eye(3) - tangent[:, :, None] * tangent[:, None, :]
    own, other = (point_covariance(fit, camera, s) for fit, s in ((followed_fit, at), (alone, at[nearest])))
    # along the thread nothing is compared, and a large variance there makes the inverse exist
    wide = np.trace(own, axis1=1, axis2=2)[:, None, None] * tangent[:, :, None] * tangent[:, None, :]
    apart = _apart(off, across @ own @ across + wide, across @ other @ across + wide)
    less_sure = np.einsum("qij,qij->q", across, other) > np.einsum("qij,qij->q", across, own)
    return float(((apart > OUTSIDE) & less_sure).mean())


def _apart(
    off: Float64[np.ndarray, "q 3"], own: Float64[np.ndarray, "q 3 3"], other: Float64[np.ndarray, "q 3 3"]
) -> Float64[np.ndarray, "q"]:
    """How far places are apart, squared, in what they may be.

    What a smaller set of the same data says differs from what all of it says by the one's covariance less the other's
    (Hausman 1978). Where that is less than the followed curve's own, that own counts: both are estimates themselves.
    """
    lower = np.linalg.cholesky(own)
    white = np.linalg.solve(lower, np.linalg.solve(lower, other).transpose(0, 2, 1))
    share, axes = np.linalg.eigh((white + white.transpose(0, 2, 1)) / 2)
    along = np.einsum("qij,qi->qj", axes, np.linalg.solve(lower, off[:, :, None])[:, :, 0])
    return (along**2 / np.maximum(share - 1, 1.0)).sum(axis=1)


def _explained(observations: ThreadObservations, fit: Refined) -> float:
    """The share of the points of both centrelines that lie on the projected curve."""
    camera = observations.camera
    found, points = 0, 0
    for eye, lines in enumerate((observations.centrelines_left, observations.centrelines_right)):
        seen_px = pixels_evenly(fit.curve, PLACES_OF_SPAN, eye, camera, fit.row_offset_px)
        distance, _ = _nearest(seen_px, lines.point_px[::4])
        found += int((distance < EXPLAINED_PX_SHARE * camera.image_width).sum())
        points += len(distance)
    return found / max(points, 1)


def _nearest(
    of: Float64[np.ndarray, "m d"], points: Float64[np.ndarray, "n d"]
) -> tuple[Float64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
    """Of each point, the distance to the nearest of others, and which that is."""
    distance, index = cKDTree(of).query(points)
    return np.asarray(distance), np.asarray(index)
