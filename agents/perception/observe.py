"""From a rectified stereo pair to ordered observations of the thread (paper, section II-B), stage by stage.

Every expected failure ends as a status with a reason in the result; nothing here raises for any image content.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.perception.both_eyes.apart import drawn_together
from agents.perception.centrelines.centrelines import NO_LINES, thread_lines
from agents.perception.following.follow import trail_of
from agents.perception.judging.alignment import judge
from agents.perception.judging.correspondence import correspondence_of
from agents.perception.mask_image import mask_image
from agents.perception.paper.clustering import Clusters, cluster_and_order
from agents.perception.paper.matching import Matches, is_inlier, match_pixels, searched_disparities
from agents.perception.segmenter_names import NETWORK, PROMPTABLE
from schemas.messages import (
    FrameStamp,
    Judgement,
    RectifiedStereo,
    Severity,
    Status,
    ThreadObservations,
)
from shared.camera import backproject, depth_of_disparity

SEGMENTED_COVERAGE = 96
"""Coverage from which a pixel counts as thread. Below one half, so that a thread that is thinner than a pixel and
falls between two still counts."""
LARGEST_SEGMENTED_SHARE = 0.05
"""Of the image; a mask that covers more shows no thread, which rarely covers 2 %, and would take seconds to match."""
ON_TISSUE = NETWORK, PROMPTABLE
"""Segmenters that find thread on tissue, where light misleads both eyes differently."""
LEAST_OBSERVATIONS = 4
"""A cubic has four control points."""


@dataclass(frozen=True)
class _Matched:
    px: Float64[np.ndarray, "p 3"]
    cost: Float64[np.ndarray, "p 2"]
    inlier: Bool[np.ndarray, "p"]


NO_MATCHES = _Matched(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0, bool))


@dataclass(frozen=True)
class _Found:
    """How far observation came: up to the reason for which it ended, or to ordered clusters."""

    reason: str
    judgements: tuple[Judgement, ...] = ()
    matched: _Matched = NO_MATCHES
    clusters: Clusters | None = None


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
    found = _find(camera, left, right, *segmented, segmenter, judged, matching, disparities_px)
    points, half_size, gaps = _observations(camera, found.clusters)
    usable = not any(judgement.severity is Severity.FAULT for judgement in found.judgements) and not _unusable_masks(
        *segmented, segmenter
    )
    of_left, of_right = (
        thread_lines(image, coverage) if usable else NO_LINES
        for image, coverage in ((left, coverage_left), (right, coverage_right))
    )
    lines = of_left.centrelines, of_right.centrelines
    if segmenter in ON_TISSUE:
        lines = drawn_together((left, right), lines, shown_px=disparities_px)
    return ThreadObservations(
        stamp=stamp,
        camera=camera,
        status=Status.FAILED if found.reason else Status.OK,
        reason=found.reason,
        segmenter=segmenter,
        points_camera=points,
        half_size_px=half_size,
        matched_px=found.matched.px,
        match_cost=found.matched.cost,
        inlier=found.matched.inlier,
        mask_left=mask_image(coverage_left),
        mask_right=mask_image(coverage_right),
        judgements=found.judgements,
        gaps=gaps,
        centrelines_left=lines[0],
        centrelines_right=lines[1],
        trail_left=trail_of(left, lines[0], of_left.loose_start, of_left.loose_end),
        trail_right=trail_of(right, lines[1], of_right.loose_start, of_right.loose_end),
        segmented_sequence=stamp.sequence,
        disparities_px=disparities_px,
    )


def _find(
    camera: RectifiedStereo,
    left: UInt8[np.ndarray, "h w 3"],
    right: UInt8[np.ndarray, "h w 3"],
    segmented_left: Bool[np.ndarray, "h w"],
    segmented_right: Bool[np.ndarray, "h w"],
    segmenter: str,
    judged: tuple[Judgement, ...] | None,
    matching: bool,
    disparities_px: Float64[np.ndarray, "2"] | None,
) -> _Found:
    """Stage by stage, as far as it goes."""
    if reason := _unusable_masks(segmented_left, segmented_right, segmenter):
        return _Found(reason)
    judgements = judged
    if judgements is None:
        judgements = judge(correspondence_of(left, right, segmented_left, segmented_right), left.shape)
    fault = next((j for j in judgements if j.severity is Severity.FAULT), None)
    if fault:
        return _Found(f"{fault.finding}; {fault.remedy}", judgements)

    if not matching:
        return _Found("", judgements)
    searched = searched_disparities(camera.image_width, disparities_px)
    matches = match_pixels(left, right, segmented_left, segmented_right, searched)
    inlier = is_inlier(matches.cost)
    matched = _Matched(np.column_stack((matches.pixel[:, ::-1], matches.disparity_px)), matches.cost, inlier)
    if reason := _unusable_matches(inlier, searched):
        return _Found(reason, judgements, matched)
    clusters = _clusters(segmented_left, matches, inlier)
    if len(clusters.disparity_px) < LEAST_OBSERVATIONS:
        reason = (
            f"only {len(clusters.disparity_px)} observations of the thread, of {int(inlier.sum())} matched pixels; "
            f"at least {LEAST_OBSERVATIONS} are needed"
        )
        return _Found(reason, judgements, matched)
    return _Found("", judgements, matched, clusters)


def _unusable_matches(inlier: Bool[np.ndarray, "p"], searched: range) -> str:
    """Why these matches tell nothing, empty where some do."""
    if len(inlier) == 0:
        return (
            "no segmented pixel of the left image has a segmented one in its row of the right image at a disparity of "
            f"{searched.start} to {searched.stop - 1} px; check that both show the same thread, rectified"
        )
    if not inlier.any():
        return f"none of {len(inlier)} matched pixels has a match that is clearly better than its second best"
    return ""


def _unusable_masks(left: Bool[np.ndarray, "h w"], right: Bool[np.ndarray, "h w"], segmenter: str) -> str:
    """Why no thread can be in these masks, empty where one can."""
    for name, segmented in (("left", left), ("right", right)):
        share = np.count_nonzero(segmented) / segmented.size
        if share == 0:
            return f"no thread was found in the {name} image by segmenter {segmenter!r}"
        if share > LARGEST_SEGMENTED_SHARE:
            return f"{share:.0%} of the {name} image is thread by segmenter {segmenter!r}, more than any thread covers"
    return ""


def _clusters(segmented: Bool[np.ndarray, "h w"], matches: Matches, inlier: Bool[np.ndarray, "p"]) -> Clusters:
    """Clusters among all segmented left pixels, of which only some were matched."""
    pixel: Int64[np.ndarray, "a 2"] = np.argwhere(segmented)
    index = np.full(segmented.shape, -1)
    index[pixel[:, 0], pixel[:, 1]] = np.arange(len(pixel))
    of_match = index[matches.pixel[:, 0], matches.pixel[:, 1]]
    disparity, kept = np.ones(len(pixel)), np.zeros(len(pixel), bool)
    disparity[of_match], kept[of_match] = matches.disparity_px, inlier
    return cluster_and_order(pixel, disparity, kept, segmented.shape)


def _observations(
    camera: RectifiedStereo, clusters: Clusters | None
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 2"], Int64[np.ndarray, "g"]]:
    if clusters is None:
        return np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0, np.int64)
    depth = depth_of_disparity(camera, clusters.disparity_px)
    gaps = np.flatnonzero(np.diff(clusters.segment) != 0)
    return backproject(camera, clusters.centroid_px, depth), clusters.half_size_px, gaps
