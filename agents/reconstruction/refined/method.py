"""Method `refined`: one spline fitted to the sub-pixel centrelines of both images.

1. `covered_ends`: how far points beside what covers them may be off.
2. `course`: the pieces of the left centreline in their order along the thread, through crossings and behind tools.
3. `alignment`: the right image's counterpart of each place, by dynamic programming along the rows.
4. `initial`: a first curve from both.
5. `refinement`: Gauss-Newton on its control points against both centrelines, smoothing chosen from the images.
6. `regions`: which matches it contradicts.
7. `posterior`: how well each place is known, and the confidence that follows.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from agents.reconstruction.paper import failed
from agents.reconstruction.refined.alignment import Alignment, align
from agents.reconstruction.refined.course import BothImages, LikeliestCourse, likeliest_course
from agents.reconstruction.refined.initial import initial_curve, with_needed_spans
from agents.reconstruction.refined.paths import Chain
from agents.reconstruction.refined.plausibility import contradiction, implausible, unusable
from agents.reconstruction.refined.projection import LEVEL, row_offsets_px
from agents.reconstruction.refined.refinement import Refined, Start, refined
from agents.reconstruction.refined.regions import matched_regions, slack_of
from agents.reconstruction.refined.result import guessed_share, reconstruction, starts_right
from agents.reconstruction.refined.sightings import (
    Sightings,
    left_sightings,
    map_of,
    parameters_of_course,
    placed,
    sightings,
    with_covered_ends,
)
from schemas.messages import (
    GIVEN_MASKS,
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    ThreadCourse,
    ThreadObservations,
    ThreadReconstruction,
)
from shared.calibration.uncertainty import usual_covariance
from shared.camera import project
from shared.disparities import disparities_of

METHOD = "refined"
MOST_ROW_ROUNDS = 5
ROWS_SETTLED_PX = 0.1
"""A calibration that is off leaves rows apart; where they change by less than this, no further round of alignment is
needed."""
MOST_GUESSED = 0.2
"""Of a first curve: so much may be neither seen by both eyes nor known to be hidden. Fitted: of 90 rendered scenes of a
lab, 76 right curves of 77 have no more, and 4 wrong ones of 8 more."""
LEAST_SCORE = 0.48
"""Of what a first curve follows, where nobody said that it is thread: `ThreadCandidate.score`, by how long it is, how
much of it both eyes show, and how sure perception is. Fitted: of 79 right curves in 90 rendered scenes of a lab one
comes to less, and of 22 curves in 666 looks at scenes without thread 16 do."""
FOLLOWED = 1.0
"""Residuals larger than the points' own deviations, in the median: the curve cannot bend as the thread does."""


class NoCurveError(ValueError):
    """There is no curve, and the text says why."""


@dataclass(frozen=True)
class Course:
    """The thread's course through the left image, what corresponds to it in the right one, and the points of both."""

    left: Chain
    aligned: Alignment
    sight: Sightings
    row_offset_px: Float64[np.ndarray, "4"]
    likeliest: LikeliestCourse


def reconstruct_refined(observations: ThreadObservations) -> ThreadReconstruction:
    """The thread that both images show, with its posterior.

    Never raises for any valid observations: a failure is a status with its reason.
    """
    if observations.status is not Status.OK:
        return failed(observations, METHOD, observations.reason)
    try:
        need_evidence(observations)
        course, fit = course_and_fit(observations)
        regions = regions_along(fit, course, observations.camera)
        reverse = starts_right(fit.curve, observations)
        told = told_course(course, fit, reverse)
        return seen_enough(reconstruction(observations, METHOD, fit, regions, reverse, told))
    except NoCurveError as error:
        return failed(observations, METHOD, str(error))


def need_evidence(observations: ThreadObservations) -> None:
    """See that enough speaks for what was found being thread, where nobody knew it before.

    Raises:
        NoCurveError: where too little does.
    """
    is_told = observations.prompt_px is not None or observations.segmenter == GIVEN_MASKS
    score = min((candidate.score for candidate in observations.candidates[:1]), default=1.0)
    if score < LEAST_SCORE and not is_told:
        raise NoCurveError(
            f"what may be thread is too short or faint to be told from what is none (score {score:.2f} of at least "
            f"{LEAST_SCORE:.2f}): show more of it to both eyes, or point at it by a prompt"
        )


def seen_enough(thread: ThreadReconstruction) -> ThreadReconstruction:
    """The same thread, that nobody knew before.

    Raises:
        NoCurveError: where too much of it is a guess.
    """
    guessed = guessed_share(thread)
    if guessed > MOST_GUESSED:
        # rounded down, so that it is below what is needed in words too
        seen = f"{math.floor(100 * (1 - guessed))}%"
        raise NoCurveError(
            f"of the curve that was found both eyes see {seen}, or what hides the rest, and {1 - MOST_GUESSED:.0%} are "
            "needed: turn the camera until both images show the thread, and clear what may pass for it"
        )
    return thread


def uncertain(observations: ThreadObservations) -> Float64[np.ndarray, "8 8"]:
    """What the calibration may be off by, or what is usual where nobody says."""
    stated = observations.calibration_covariance
    return usual_covariance() if stated is None else stated


def course_and_fit(observations: ThreadObservations) -> tuple[Course, Refined]:
    """The thread's course and the curve fitted to it, aligned again for as long as the rows turn out to be apart.

    Raises:
        NoCurveError: where there is no curve that can be the thread.
    """
    camera, of_calibration = observations.camera, uncertain(observations)
    course = course_of(observations)
    fit = fitted(course, camera, of_calibration)
    for _ in range(MOST_ROW_ROUNDS):
        if _rows_apart_px(fit, course, camera) < ROWS_SETTLED_PX:
            break
        course = course_of(observations, fit.row_offset_px)
        fit = fitted(course, camera, of_calibration)
    if reason := implausible(fit, camera):
        raise NoCurveError(reason)
    return course, fit


def course_of(observations: ThreadObservations, row_offset_px: Float64[np.ndarray, "4"] = LEVEL) -> Course:
    """The likeliest thread of the left image that the right one shows too, so many rows lower.

    Raises:
        NoCurveError: where there is none.
    """
    camera, reach = observations.camera, disparities_of(observations)
    left, right = observations.centrelines_left, observations.centrelines_right
    if reason := unusable(left, right, camera):
        raise NoCurveError(reason)
    left, right = with_covered_ends(left), with_covered_ends(right)
    lower_px = row_offsets_px(right.point_px, row_offset_px, camera)
    level = replace(right, point_px=right.point_px - lower_px[:, None] * (0.0, 1.0))
    occluders = None if observations.occluders is None else map_of(observations.occluders.left)
    size_px = camera.image_width, camera.image_height
    found = likeliest_course(BothImages(left, level, reach, size_px, occluders))
    if found is None:
        raise NoCurveError("the left image shows no piece of thread that is longer than some widths of it")
    aligned = align(found.chain, level, reach)
    reason = contradiction(aligned, camera)
    if aligned is None or reason:
        raise NoCurveError(reason)
    return Course(found.chain, aligned, sightings(found.chain, right, aligned), row_offset_px, found)


def _rows_apart_px(fit: Refined, course: Course, camera: RectifiedStereo) -> float:
    """By how much the rows of a point of the right image are elsewhere than the course was sought with, at most."""
    right = fit.sight.point_px[fit.sight.eye == 1]
    return float(np.abs(row_offsets_px(right, fit.row_offset_px - course.row_offset_px, camera)).max(initial=0.0))


def fitted(course: Course, camera: RectifiedStereo, of_calibration: Float64[np.ndarray, "8 8"]) -> Refined:
    """The refined curve of a course.

    Raises:
        NoCurveError: where the equations have no solution.
    """
    try:
        start, s = initial_curve(course.left, course.aligned, course.sight.s, camera)
        begun = Start(
            start, replace(course.sight, s=s), row_offset_px=course.row_offset_px, of_calibration=of_calibration
        )
        fit = refined(begun, camera)
        if fit.scale <= FOLLOWED:
            return fit
        denser = with_needed_spans(fit.curve, camera)
        if denser is None:
            return fit
        return refined(replace(begun, curve=denser, sight=fit.sight, row_offset_px=fit.row_offset_px), camera)
    except np.linalg.LinAlgError as error:
        raise NoCurveError(f"no curve follows from both images ({error})") from error


def told_course(course: Course, fit: Refined, reverse: bool) -> ThreadCourse:
    """The course in arc lengths of its curve, or from the curve's other end."""
    chain, found = course.left, course.likeliest
    order = np.argsort(chain.index)
    share = chain.along_px / chain.along_px[-1]

    def along(index: Int64[np.ndarray, "k 2"]) -> Float64[np.ndarray, "k 2"]:
        at = order[np.searchsorted(chain.index[order], index.ravel())]
        s = parameters_of_course(course.sight, fit.sight, share[at]).reshape(-1, 2)
        return 1.0 - s if reverse else s

    joins = np.sort(along(found.joins), axis=1)
    first = np.argsort(joins[:, 0], kind="stable")
    return ThreadCourse(joins[first], found.probability[first], along(found.other))


def regions_along(fit: Refined, course: Course, camera: RectifiedStereo) -> ReliabilityRegions:
    """The reliability regions of a course, in order along its curve."""
    regions, share = matched_regions(course.left, course.aligned, camera)
    pixels, _ = project(camera, regions.centre_camera)
    along = parameters_of_course(course.sight, fit.sight, share)
    s = placed(left_sightings(pixels, along), fit.curve, camera, fit.row_offset_px, rounds=2).s
    slack, order = slack_of(regions, s, fit.curve, camera), np.argsort(s, kind="stable")
    return ReliabilityRegions(
        s[order], regions.centre_camera[order], regions.bound_px[order], regions.bound_depth[order], slack[order]
    )
