"""Rounds of correction that draw curves to the middle of the thread, and what each point then is worth."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from agents.perception.centrelines.along import (
    STRIDE,
    Pieces,
    blurred,
    directions,
    gaussian,
    local_quadratic,
    smoothed,
)
from agents.perception.centrelines.edges import find_edges
from agents.perception.centrelines.learned import (
    has_plain_ground,
    learned_middles,
    reach_px,
    seen_across,
    straightened,
    usual_width_px,
)
from agents.perception.centrelines.profiles import by_channel, middle, normals, offsets, own_strand, sample

MARGIN_PX = 2.0
"""Beyond the thread's own edge that a profile of coverage looks; one of the image looks twice as far."""
ALONG_PX = 2.0
"""Standard deviation of the average of neighbouring profiles in which edges are looked for."""
LIGHT_PX = 1.5
"""Standard deviation of the local parabolas that smooth corrected points."""
LEAST_WIDTH_PX = 0.1
ASIDE_ALONG_PX, USUAL_ASIDE_PX = 8.0, 0.15
FROM_CUT_WIDTHS = 2.0
"""From half as far to half as far again the edges give way to what is learned."""
SEEN_ALONG_PX = 1.5
"""Standard deviation of the average along the thread of every second profile, as the network is shown them: neighbours
hardly differ."""


@dataclass(frozen=True)
class Curves:
    """Points along pieces, and of each piece whether it begins and ends at a loose end of the thread."""

    point: Float64[np.ndarray, "n 2"]
    pieces: Pieces
    loose_start: Bool[np.ndarray, "k"]
    loose_end: Bool[np.ndarray, "k"]


@dataclass(frozen=True)
class Evidence:
    """What the last round saw at each point.

    Fields:
        width_px: of the thread.
        aside_px: how far different views of the middle lie apart, to one side or the other.
        open: whether the thread fills its profile to the end.
    """

    width_px: Float64[np.ndarray, "n"]
    aside_px: Float64[np.ndarray, "n"]
    open: Bool[np.ndarray, "n"]


def tangent_sigma(width: float) -> float:
    """Over how many points a direction is taken: a wide thread bends slowly, and its skeleton jitters more."""
    return min(max(0.5 * width, 2.0), 4.0)


def to_ends(curves: Curves, loose: bool) -> Float64[np.ndarray, "n"]:
    """How many points lie between each point and its piece's nearest end of the kind; infinite without one."""
    pieces = curves.pieces
    start = np.where(curves.loose_start[pieces.number] == loose, pieces.before, np.inf)
    end = np.where(curves.loose_end[pieces.number] == loose, pieces.after, np.inf)
    return np.minimum(start, end)


def by_coverage(curves: Curves, coverage: Float32[np.ndarray, "h w"], width: float) -> tuple[Curves, Evidence]:
    """One round: every point to the centroid of the coverage across it."""
    normal = normals(directions(curves.point, curves.pieces, gaussian(tangent_sigma(width))))
    at = offsets(width / 2 + MARGIN_PX)
    found = middle(own_strand(sample(coverage, curves.point, normal, at)), at)
    shift = np.clip(found.offset_px, -width / 2, width / 2)
    moved = _moved(curves, normal, shift)
    return moved, Evidence(np.maximum(found.width_px, LEAST_WIDTH_PX), np.zeros(len(shift)), found.open)


def by_edges(
    curves: Curves, mask: Evidence, image: UInt8[np.ndarray, "h w 3"], width: float
) -> tuple[Curves, Evidence]:
    """One round: every point to the middle between the thread's edges in the image.

    Args:
        curves: in the middle of the mask.
        mask: what a round by coverage saw at the same points.
        width: of the thread in general.
    """
    at, kernel = offsets(width / 2 + 2 * MARGIN_PX), gaussian(ALONG_PX)
    mask_width = smoothed(mask.width_px[:, None], curves.pieces, kernel)[:, 0]
    normal = normals(directions(curves.point, curves.pieces, gaussian(tangent_sigma(width))))
    some, sampled = curves.pieces.every_second
    within, thinned = sampled.every_second
    colour = sample(image, curves.point[some], normal[some], at, cv2.BORDER_REPLICATE)
    colour, some = blurred(colour, sampled, gaussian(ALONG_PX / STRIDE), within), some[within]
    edges = find_edges(by_channel(colour), at, mask_width[some], thinned)
    near, far = (np.interp(np.arange(len(normal)), some, edge) for edge in (edges.near_px, edges.far_px))
    # both edges may lie off the mask's, but in the same direction only as far as a mask is wrong
    limit = 0.5 + 0.25 * width
    shift = np.clip((near + far) / 2, -limit, limit)
    width_px = np.maximum(far - near, LEAST_WIDTH_PX)
    return _moved(curves, normal, shift), Evidence(width_px, shift, mask.open)


def by_learning(
    curves: Curves, edges: Evidence, image: UInt8[np.ndarray, "h w 3"], width: float
) -> tuple[Curves, Evidence, Float64[np.ndarray, "n"]] | None:
    """One round: every point to where the network holds the middle to be; and the standard deviation of that.

    None over a plain ground, which casts no light on a thread and shows no edges but the thread's: nothing beats those.

    Args:
        curves: in the middle between the edges.
        edges: what a round by edges saw at the same points.
        width: of the thread in general.
    """
    pieces = curves.pieces
    usual = usual_width_px(edges.width_px, pieces)
    normal = normals(directions(curves.point, pieces, gaussian(tangent_sigma(width))))
    some, sampled = pieces.every_second
    colour = seen_across(image, curves.point[some], normal[some], reach_px(usual[some]))
    colour = blurred(colour, sampled, gaussian(SEEN_ALONG_PX / STRIDE))
    if has_plain_ground(colour, usual[some]):
        return None
    profiles = straightened(colour, usual[some], sampled)
    found = learned_middles(profiles, normal[some], sampled, every_second=True)
    some = some[sampled.every_second[0]]
    offset, deviation = (np.interp(np.arange(len(usual)), some, part) for part in (found.offset_px, found.deviation_px))
    limit = 0.5 + 0.25 * width
    # beside a cut the profile also holds the strand that is crossed
    apart = np.clip(to_ends(curves, loose=False) / (FROM_CUT_WIDTHS * usual) - 0.5, 0, 1)
    # single profiles of a mask and of an image differ by chance, and the network has seen by how much an image misleads
    aside = smoothed(edges.aside_px[:, None], pieces, gaussian(ASIDE_ALONG_PX))[:, 0]
    aside = np.sign(aside) * np.maximum(np.abs(aside) - USUAL_ASIDE_PX, 0)
    return _moved(curves, normal, apart * np.clip(offset, -limit, limit)), replace(edges, aside_px=aside), deviation


def _moved(curves: Curves, normal: Float64[np.ndarray, "n 2"], shift: Float64[np.ndarray, "n"]) -> Curves:
    point = smoothed(curves.point + shift[:, None] * normal, curves.pieces, local_quadratic(LIGHT_PX))
    return replace(curves, point=point)
