"""Where the thread crosses itself in the left image, and which strand lies nearer; and thread that is not this one.

Two pieces of a polyline cross where each one's line parts the ends of the other. The depths of both strands there
differ by about the thread's thickness where they touch, so the nearer one is told only where that difference exceeds
some deviations of the posterior.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from agents.reconstruction.refined.projection import Curve, chords
from schemas.messages import Centrelines, Crossing, Over, RectifiedStereo, ThreadCandidate
from shared.camera import project

PLACES = 241
SHORTEST_LOOP = 0.02
"""Of the thread's length: less between two crossing pieces is a kink of the curve."""
CERTAIN = 2.0
"""Deviations by which the strands' depths differ before one is called nearer."""
EVERY, CANDIDATE_PX = 4, 8.0
"""Of the points of a piece, so many are looked at; and so far apart lie those of candidates."""
STRANGE_WIDTHS, SHORTEST_WIDTHS = 3.0, 15.0
"""A piece of centreline is another thread's where it lies so far off, in the median, and is so long."""


def crossings_of(
    camera: RectifiedStereo,
    curve: Curve,
    covariance_s: Float64[np.ndarray, "q"],
    covariance: Float64[np.ndarray, "q 3 3"],
) -> tuple[Crossing, ...]:
    """Every self-crossing of the projected curve, in order along it.

    Args:
        covariance: of the curve's points at `covariance_s`; strands count as independent of each other.
    """
    points = curve.at(np.linspace(0.0, 1.0, PLACES))
    pixels, _ = project(camera, points)
    first, second = _crossing_pieces(pixels)
    if not len(first):
        return ()
    share_first, share_second = _shares(pixels, first, second)
    depth_first = points[first, 2] + share_first * (points[first + 1, 2] - points[first, 2])
    depth_second = points[second, 2] + share_second * (points[second + 1, 2] - points[second, 2])
    at = pixels[first] + share_first[:, None] * (pixels[first + 1] - pixels[first])
    s_first, s_second = (first + share_first) / (PLACES - 1), (second + share_second) / (PLACES - 1)
    variance = sum(np.interp(place, covariance_s, covariance[:, 2, 2]) for place in (s_first, s_second))
    apart = depth_second - depth_first
    known = np.abs(apart) > CERTAIN * np.sqrt(variance)
    return tuple(
        Crossing(
            s_first=float(s_first[k]),
            s_second=float(s_second[k]),
            point_px=at[k],
            over=(Over.FIRST if apart[k] > 0 else Over.SECOND) if known[k] else Over.UNDETERMINED,
            depth_apart=float(apart[k]),
        )
        for k in range(len(first))
    )


def other_threads_px(lines: Centrelines, curve_px: cKDTree) -> Float64[np.ndarray, "t 2"]:
    """The middle of each longer piece of centreline that does not lie on the projected curve."""
    if not len(lines.piece):
        return np.zeros((0, 2))
    width, apart_px = np.median(lines.width_px), _apart_px(lines)
    bounds = np.concatenate(([0], np.flatnonzero(np.diff(lines.piece)) + 1, [len(lines.piece)]))
    found = [
        lines.point_px[first + (end - first) // 2]
        for first, end in pairwise(bounds)
        if (end - first) * apart_px >= SHORTEST_WIDTHS * width
        # a piece lies on the curve where most of some of its points do
        and np.median(np.asarray(curve_px.query(lines.point_px[first:end:EVERY])[0])) > STRANGE_WIDTHS * width
    ]
    return np.array(found) if found else np.zeros((0, 2))


def other_threads(candidates: tuple[ThreadCandidate, ...], curve_px: cKDTree) -> tuple[ThreadCandidate, ...]:
    """The candidates that are none of the projected curve, by score."""
    found = [
        candidate
        for candidate in candidates
        if np.median(np.asarray(curve_px.query(candidate.left_px)[0])) > STRANGE_WIDTHS * candidate.width_px
    ]
    return tuple(sorted(found, key=lambda candidate: -candidate.score))


def left_over(
    lines: Centrelines, curve_px: cKDTree, others: tuple[ThreadCandidate, ...]
) -> tuple[float | None, Float64[np.ndarray, "l 2"]]:
    """How much of the centrelines lies on no thread, and the middle of each longer stretch; None without any."""
    if not len(lines.piece):
        return None, np.zeros((0, 2))
    near = STRANGE_WIDTHS * np.median(lines.width_px)
    away = np.asarray(curve_px.query(lines.point_px)[0]) > near
    for other in others:
        away[away] = np.asarray(cKDTree(other.left_px).query(lines.point_px[away])[0]) > near + CANDIDATE_PX
    starts = np.flatnonzero(np.diff(lines.piece, prepend=-1) | np.diff(away, prepend=False))
    runs = [run for run in np.split(np.arange(len(away)), starts) if len(run) and away[run[0]]]
    shortest = SHORTEST_WIDTHS * np.median(lines.width_px) / _apart_px(lines)
    middles = [lines.point_px[run[len(run) // 2]] for run in runs if len(run) >= shortest]
    return float(away.mean()), np.array(middles).reshape(-1, 2)


def _apart_px(lines: Centrelines) -> float:
    """How far neighbours lie apart, in the median."""
    return float(np.median(chords(lines.point_px))) if len(lines.piece) > 1 else 1.0


def with_middles(
    found_px: Float64[np.ndarray, "t 2"], others: tuple[ThreadCandidate, ...]
) -> Float64[np.ndarray, "u 2"]:
    """Pixels on other threads, with one on each candidate that none of them lies on."""
    missing = [
        candidate.left_px[len(candidate.left_px) // 2]
        for candidate in others
        if not len(found_px)
        or np.min(cKDTree(candidate.left_px).query(found_px)[0]) > STRANGE_WIDTHS * candidate.width_px + CANDIDATE_PX
    ]
    return np.vstack((found_px, *missing))


def _crossing_pieces(px: Float64[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of both pieces of each crossing of a polyline with itself, the earlier one first."""
    # about their middle, so that products of places lose no digits
    px = px - px.mean(axis=0)
    across = (px[1:] - px[:-1])[:, ::-1] * (-1.0, 1.0)
    beside = across @ px.T > (across * px[:-1]).sum(axis=1)[:, None]
    parts = beside[:, :-1] != beside[:, 1:]
    first, second = np.divmod(np.flatnonzero(parts & parts.T), len(across))
    loop = second - first > SHORTEST_LOOP * len(across)
    return first[loop], second[loop]


def _shares(
    px: Float64[np.ndarray, "n 2"], first: np.ndarray, second: np.ndarray
) -> tuple[Float64[np.ndarray, "c"], Float64[np.ndarray, "c"]]:
    """How far along each of two crossing pieces the crossing lies."""
    a, b = px[first + 1] - px[first], px[second + 1] - px[second]
    gap = px[second] - px[first]
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    cross = np.where(np.abs(cross) > 1e-12, cross, 1e-12)
    share_first = (gap[:, 0] * b[:, 1] - gap[:, 1] * b[:, 0]) / cross
    share_second = (gap[:, 0] * a[:, 1] - gap[:, 1] * a[:, 0]) / cross
    return np.clip(share_first, 0.0, 1.0), np.clip(share_second, 0.0, 1.0)
