"""From a rectified stereo pair to observations of the thread: its centrelines, and for method `paper` its pixels.

Every expected failure ends as a status with a reason in the result; nothing here raises for any image content.
"""

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.both_eyes.apart import drawn_together
from agents.perception.centrelines.centrelines import NO_LINES, SEGMENTED_COVERAGE, thread_lines
from agents.perception.following.follow import trail_of
from agents.perception.judging.alignment import judge
from agents.perception.judging.correspondence import correspondence_of
from agents.perception.mask_image import mask_image
from agents.perception.paper.matched import MatchedPixels, matched_pixels
from agents.perception.segmenter_names import NETWORK, PROMPTABLE
from schemas.messages import FrameStamp, Judgement, RectifiedStereo, Severity, Status, ThreadObservations

LARGEST_SEGMENTED_SHARE = 0.05
"""Of the image; a mask that covers more shows no thread, which rarely covers 2 %, and would take seconds to match."""
ON_TISSUE = NETWORK, PROMPTABLE
"""Segmenters that find thread on tissue, where light misleads both eyes differently."""


def observe(
    stamp: FrameStamp,
    camera: RectifiedStereo,
    left: UInt8[np.ndarray, "h w 3"],
    right: UInt8[np.ndarray, "h w 3"],
    coverage_left: UInt8[np.ndarray, "h w"],
    coverage_right: UInt8[np.ndarray, "h w"],
    segmenter: str,
    judged: tuple[Judgement, ...] | None = None,
    matching: bool = True,
    disparities_px: Float64[np.ndarray, "2"] | None = None,
) -> ThreadObservations:
    """The centrelines of a rectified pair, and the matches of its segmented pixels, clustered and ordered.

    Args:
        judged: judgements of this pair or of an earlier one of these cameras; the pair is judged if it is None.
        matching: whether pixels are matched; only method `paper` needs it, and it takes the longest.
        disparities_px: least and greatest of thread, as far as the pair shows them.
    """
    segmented = coverage_left >= SEGMENTED_COVERAGE, coverage_right >= SEGMENTED_COVERAGE
    reason, judgements = _unusable_masks(*segmented, segmenter), ()
    if not reason:
        judgements = judge(correspondence_of(left, right, *segmented), left.shape) if judged is None else judged
        fault = next((judgement for judgement in judgements if judgement.severity is Severity.FAULT), None)
        reason = f"{fault.finding}; {fault.remedy}" if fault else ""
    of_left = of_right = NO_LINES
    matched = MatchedPixels()
    if not reason:
        of_left, of_right = thread_lines(left, coverage_left), thread_lines(right, coverage_right)
        matched = matched_pixels(camera, left, right, *segmented, disparities_px) if matching else matched
        reason = matched.reason
    lines = of_left.centrelines, of_right.centrelines
    if segmenter in ON_TISSUE:
        lines = drawn_together((left, right), lines, shown_px=disparities_px)
    return ThreadObservations(
        stamp=stamp,
        camera=camera,
        status=Status.FAILED if reason else Status.OK,
        reason=reason,
        segmenter=segmenter,
        points_camera=matched.points_camera,
        half_size_px=matched.half_size_px,
        matched_px=matched.matched_px,
        match_cost=matched.match_cost,
        inlier=matched.inlier,
        mask_left=mask_image(coverage_left),
        mask_right=mask_image(coverage_right),
        judgements=judgements,
        gaps=matched.gaps,
        centrelines_left=lines[0],
        centrelines_right=lines[1],
        trail_left=trail_of(left, lines[0], of_left.loose_start, of_left.loose_end),
        trail_right=trail_of(right, lines[1], of_right.loose_start, of_right.loose_end),
        segmented_sequence=stamp.sequence,
        disparities_px=disparities_px,
    )


def _unusable_masks(left: Bool[np.ndarray, "h w"], right: Bool[np.ndarray, "h w"], segmenter: str) -> str:
    """Why no thread can be in these masks, empty where one can."""
    for name, segmented in (("left", left), ("right", right)):
        share = np.count_nonzero(segmented) / segmented.size
        if share == 0:
            return f"no thread was found in the {name} image by segmenter {segmenter!r}"
        if share > LARGEST_SEGMENTED_SHARE:
            return f"{share:.0%} of the {name} image is thread by segmenter {segmenter!r}, more than any thread covers"
    return ""
