"""Rounds of correction that draw curves to the middle of the thread, and what each point then is worth."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from agents.perception.centrelines.along import (
    blurred,
    directions,
    gaussian,
    local_quadratic,
    smoothed,
)
from agents.perception.centrelines.edges import find_edges
from agents.perception.centrelines.profiles import middle, normals, offsets, own_strand, sample

MARGIN_PX = 2.0
"""Beyond the thread's own edge that a profile of coverage looks; one of the image looks twice as far."""
ALONG_PX = 2.0
"""Standard deviation of the average of neighbouring profiles in which edges are looked for."""
LIGHT_PX = 1.5
"""Standard deviation of the local parabolas that smooth corrected points."""
LEAST_WIDTH_PX = 0.1


@dataclass(frozen=True)
class Curves:
    """Points along pieces, and of each piece whether it begins and ends at a loose end of the thread."""

    point: Float64[np.ndarray, "n 2"]
    piece: Int64[np.ndarray, "n"]
    loose_start: Bool[np.ndarray, "k"]
    loose_end: Bool[np.ndarray, "k"]


@dataclass(frozen=True)
class Evidence:
    """What the last round saw at each point.

    Fields:
        width_px: of the thread.
        doubt_px: how far apart different views of the middle lie.
        open: whether the thread fills its profile to the end.
    """

    width_px: Float64[np.ndarray, "n"]
    doubt_px: Float64[np.ndarray, "n"]
    open: Bool[np.ndarray, "n"]


def tangent_sigma(width: float) -> float:
    """Over how many points a direction is taken: a wide thread bends slowly, and its skeleton jitters more."""
    return float(np.clip(0.5 * width, 2.0, 4.0))


def by_coverage(curves: Curves, coverage: Float32[np.ndarray, "h w"], width: float) -> tuple[Curves, Evidence]:
    """One round: every point to the centroid of the coverage across it."""
    normal = normals(directions(curves.point, curves.piece, gaussian(tangent_sigma(width))))
    at = offsets(width / 2 + MARGIN_PX)
    found = middle(own_strand(sample(coverage, curves.point, normal, at)), at)
    shift = np.clip(found.offset_px, -width / 2, width / 2)
    moved = _moved(curves, normal, shift)
    return moved, Evidence(np.maximum(found.width_px, LEAST_WIDTH_PX), np.zeros(len(shift)), found.open)


def by_edges(
    curves: Curves, coverage: Float32[np.ndarray, "h w"], channel: Float32[np.ndarray, "h w"], width: float
) -> tuple[Curves, Evidence]:
    """One round: every point to the middle between the thread's two edges in the contrast channel."""
    normal = normals(directions(curves.point, curves.piece, gaussian(tangent_sigma(width))))
    at = offsets(width / 2 + 2 * MARGIN_PX)
    kernel = gaussian(ALONG_PX)
    own = blurred(own_strand(sample(coverage, curves.point, normal, at)), curves.piece, kernel)
    mask = middle(own, at)
    seen = blurred(sample(channel, curves.point, normal, at, cv2.BORDER_REPLICATE), curves.piece, kernel)
    edges = find_edges(seen, at, mask.offset_px, mask.width_px)
    middle_px = (edges.near_px + edges.far_px) / 2
    # an edge may lie off the mask's, but both in the same direction only as far as the mask may be wrong
    limit = 0.5 + 0.25 * width
    shift = mask.offset_px + np.clip(middle_px - mask.offset_px, -limit, limit)
    shift = np.clip(shift, -width / 2 - 1, width / 2 + 1)
    seen_width = np.maximum(edges.far_px - edges.near_px, LEAST_WIDTH_PX)
    evidence = Evidence(seen_width, np.abs(middle_px - mask.offset_px), mask.open)
    return _moved(curves, normal, shift), evidence


def _moved(curves: Curves, normal: Float64[np.ndarray, "n 2"], shift: Float64[np.ndarray, "n"]) -> Curves:
    point = smoothed(curves.point + shift[:, None] * normal, curves.piece, local_quadratic(LIGHT_PX))
    return replace(curves, point=point)
