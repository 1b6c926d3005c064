"""Matched, clustered and ordered pixels of a pair (paper, section II-B), which method `paper` alone needs."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.perception.paper.clustering import Clusters, cluster_and_order
from agents.perception.paper.matching import Matches, is_inlier, match_pixels, searched_disparities
from schemas.messages import RectifiedStereo
from shared.camera import backproject, depth_of_disparity

LEAST_OBSERVATIONS = 4
"""A cubic has four control points."""


@dataclass(frozen=True)
class MatchedPixels:
    """As of `ThreadObservations`, whose fields these are; none without matches.

    Fields:
        reason: why these tell nothing; empty where they do.
    """

    reason: str = ""
    points_camera: Float64[np.ndarray, "n 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    half_size_px: Float64[np.ndarray, "n 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    matched_px: Float64[np.ndarray, "p 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    match_cost: Float64[np.ndarray, "p 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    inlier: Bool[np.ndarray, "p"] = field(default_factory=lambda: np.zeros(0, bool))
    gaps: Int64[np.ndarray, "g"] = field(default_factory=lambda: np.zeros(0, np.int64))


def matched_pixels(
    camera: RectifiedStereo,
    left: UInt8[np.ndarray, "h w 3"],
    right: UInt8[np.ndarray, "h w 3"],
    segmented_left: Bool[np.ndarray, "h w"],
    segmented_right: Bool[np.ndarray, "h w"],
    disparities_px: Float64[np.ndarray, "2"] | None,
) -> MatchedPixels:
    """The segmented pixels of a pair, as far as they match."""
    searched = searched_disparities(camera.image_width, disparities_px)
    matches = match_pixels(left, right, segmented_left, segmented_right, searched)
    inlier = is_inlier(matches.cost)
    px = np.column_stack((matches.pixel[:, ::-1], matches.disparity_px))
    found = MatchedPixels(matched_px=px, match_cost=matches.cost, inlier=inlier)
    if reason := _unusable_matches(inlier, searched):
        return replace(found, reason=reason)
    clusters = _clusters(segmented_left, matches, inlier)
    if len(clusters.disparity_px) < LEAST_OBSERVATIONS:
        reason = (
            f"only {len(clusters.disparity_px)} observations of the thread, of {int(inlier.sum())} matched pixels; "
            f"at least {LEAST_OBSERVATIONS} are needed"
        )
        return replace(found, reason=reason)
    depth = depth_of_disparity(camera, clusters.disparity_px)
    return replace(
        found,
        points_camera=backproject(camera, clusters.centroid_px, depth),
        half_size_px=clusters.half_size_px,
        gaps=np.flatnonzero(np.diff(clusters.segment) != 0),
    )


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


def _clusters(segmented: Bool[np.ndarray, "h w"], matches: Matches, inlier: Bool[np.ndarray, "p"]) -> Clusters:
    """Clusters among all segmented left pixels, of which only some were matched."""
    pixel: Int64[np.ndarray, "a 2"] = np.argwhere(segmented)
    index = np.full(segmented.shape, -1)
    index[pixel[:, 0], pixel[:, 1]] = np.arange(len(pixel))
    of_match = index[matches.pixel[:, 0], matches.pixel[:, 1]]
    disparity, kept = np.ones(len(pixel)), np.zeros(len(pixel), bool)
    disparity[of_match], kept[of_match] = matches.disparity_px, inlier
    return cluster_and_order(pixel, disparity, kept, segmented.shape)
