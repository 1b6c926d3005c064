"""From a fit to the message: direction, regions, posterior, confidence, and what not both images show."""

import numpy as np
import scipy.special
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

from agents.reconstruction.paper import assumed_unit
from agents.reconstruction.refined.crossings import (
    crossings_of,
    left_over,
    other_threads,
    other_threads_px,
    with_middles,
)
from agents.reconstruction.refined.posterior import bent_covariance, point_covariance
from agents.reconstruction.refined.projection import DEGREE, DENSE, Curve, chords, even_parameters, pixels_evenly
from agents.reconstruction.refined.refinement import Refined
from agents.reconstruction.refined.sightings import hidden_of
from schemas.messages import (
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    ThreadCourse,
    ThreadObservations,
    ThreadReconstruction,
    ThreadTrack,
)
from shared.camera import project

SAMPLED = np.linspace(0.0, 1.0, 100)
TOLERANCE_M = 0.001
"""Confidence is the probability that the thread lies within this distance of the curve: what a grasp forgives."""
UNSEEN_SAMPLES = 400
GAP_FACTOR = 4.0
LEAST_GAP = 0.008
"""Of the thread's length: sightings farther apart than this, and than some times their usual distance, leave a gap."""
LEAST_VARIANCE = 1e-300
NARROWEST = 0.1
"""Of the tolerance: a narrower distribution is inside to one in 10²⁰, and the quadrature would miss its peak."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)
OUTLIER = 0.1
"""A sighting of less robust weight is none of this place."""


def reconstruction(
    observations: ThreadObservations,
    method: str,
    fit: Refined,
    regions: ReliabilityRegions,
    reverse: bool,
    course: ThreadCourse | None,
    track: ThreadTrack | None = None,
) -> ThreadReconstruction:
    """The message; `reverse` exchanges the thread's ends, but not those of its course."""
    camera, curve = observations.camera, fit.curve
    s = SAMPLED
    covariance = point_covariance(fit, camera, s)
    if observations.calibration_covariance is not None:
        covariance = covariance + bent_covariance(fit, camera, s, observations.calibration_covariance)
    unit_m = camera.metres_per_unit or assumed_unit(curve.control_points[:, 2])
    confidence = confidence_of(curve.with_velocities(s)[1], covariance, unit_m)
    not_seen = ~seen(fit, camera)
    unseen = stretches(not_seen)
    hidden = hidden_of(project(camera, curve.at(_places())), not_seen, observations.occluders, camera.image_width)
    way = slice(None, None, -1 if reverse else 1)
    turned, covariance = (
        Curve(curve.knots, curve.control_points[way].copy()) if reverse else curve,
        covariance[way].copy(),
    )
    pixels = cKDTree(_pixels(turned, camera), balanced_tree=False)
    others = other_threads(observations.candidates, pixels)
    left_over_share, left_over_px = left_over(observations.centrelines_left, pixels, others)
    return ThreadReconstruction(
        stamp=observations.stamp,
        camera=camera,
        status=Status.OK,
        reason="",
        method=method,
        degree=DEGREE,
        knots=curve.knots,
        control_points_camera=turned.control_points,
        regions=ReliabilityRegions(
            _turned(regions.s, reverse),
            regions.centre_camera[way].copy(),
            regions.bound_px[way].copy(),
            regions.bound_depth[way].copy(),
            regions.slack[way].copy(),
        ),
        confidence_s=s,
        confidence=confidence[way].copy(),
        posterior_s=s,
        posterior_covariance=covariance,
        unseen=_stretches_turned(unseen, reverse),
        track=track,
        crossings=crossings_of(camera, turned, s, covariance),
        other_threads_px=with_middles(other_threads_px(observations.centrelines_left, pixels), others),
        hidden=None if hidden is None else _stretches_turned(stretches(hidden.places), reverse),
        ends_hidden=None if hidden is None else hidden.ends[way].copy(),
        other_threads=others,
        left_over_share=left_over_share,
        left_over_px=left_over_px,
        calibration_covariance=observations.calibration_covariance,
        course=course,
    )


def guessed_share(thread: ThreadReconstruction) -> float:
    """How much of the thread's length not both images show though nothing is known to hide it."""
    places = _places()
    unseen, hidden = (
        ((places[:, None] >= stretches[:, 0]) & (places[:, None] <= stretches[:, 1])).any(axis=1)
        for stretches in (thread.unseen, np.empty((0, 2)) if thread.hidden is None else thread.hidden)
    )
    return float((unseen & ~hidden).mean())


def _pixels(curve: Curve, camera: RectifiedStereo) -> Float64[np.ndarray, "n 2"]:
    return project(camera, curve.at(np.linspace(0.0, 1.0, UNSEEN_SAMPLES)))[0]


def starts_right(curve: Curve, observations: ThreadObservations) -> bool:
    """Whether the curve's first end is the right one in the left image (ties: the lower), and so is to be its last."""
    ends, _ = project(observations.camera, curve.control_points[[0, -1]])
    return bool(tuple(ends[0]) > tuple(ends[1]))


def confidence_of(
    tangents: Float64[np.ndarray, "q 3"], covariance: Float64[np.ndarray, "q 3 3"], unit_m: float
) -> Float64[np.ndarray, "q"]:
    """The probability that the thread passes within the tolerance, from the covariance normal to it.

    For a normal distribution with deviations a ≥ b along its axes, over a disc of radius r and with x = r sin φ,

        P = ∫ φ_a(x) erf(√(r² − x²) / (√2 b)) dx,

    by Gauss-Legendre quadrature over φ, which takes the root out of the ends.
    """
    plane = _across(tangents)
    (p, q), (_, r) = (plane @ covariance @ plane.transpose(0, 2, 1)).transpose(1, 2, 0)
    middle, half = 0.5 * (p + r), np.hypot(0.5 * (p - r), q)
    variance = np.stack((middle - half, middle + half))
    b, a = np.sqrt(np.maximum(variance, LEAST_VARIANCE))[:, :, None] * unit_m / TOLERANCE_M
    # far narrower than the disc it is all inside, and the quadrature need not find it
    a, b = np.maximum(a, NARROWEST), np.maximum(b, NARROWEST)
    # the same on both sides of none
    angle, weight = 0.5 * np.pi * NODES[NODES > 0], np.pi * WEIGHTS[NODES > 0]
    density = np.exp(-0.5 * (np.sin(angle) / a) ** 2) / (np.sqrt(2.0 * np.pi) * a)
    inside = scipy.special.erf(np.cos(angle) / (np.sqrt(2.0) * b))
    return np.clip((density * inside * np.cos(angle)) @ weight, 0.0, 1.0)


def _across(tangents: Float64[np.ndarray, "q 3"]) -> Float64[np.ndarray, "q 2 3"]:
    """Two unit vectors at right angles to each tangent and to each other."""
    least = np.eye(3)[np.abs(tangents).argmin(axis=1)]
    first = _cross(tangents, least)
    second = _cross(tangents, first)
    plane = np.stack((first, second), axis=1)
    return plane / np.maximum(np.linalg.norm(plane, axis=2, keepdims=True), LEAST_VARIANCE)


def _cross(a: Float64[np.ndarray, "q 3"], b: Float64[np.ndarray, "q 3"]) -> Float64[np.ndarray, "q 3"]:
    """NumPy's own takes five times as long for a hundred vectors."""
    return a[:, (1, 2, 0)] * b[:, (2, 0, 1)] - a[:, (2, 0, 1)] * b[:, (1, 2, 0)]


def seen(fit: Refined, camera: RectifiedStereo) -> Bool[np.ndarray, "g"]:
    """Which of evenly spaced places both images show; with one alone, the depth is a guess.

    Gaps are measured along the image of the curve in that eye: along the line of sight, few pixels are much thread.
    """
    at = _places()
    good = fit.robust[: fit.rows.sightings] > OUTLIER
    shown = np.ones(UNSEEN_SAMPLES, bool)
    for eye in (0, 1):
        s = np.sort(fit.sight.s[good & (fit.sight.eye == eye)])
        if len(s) < 2:
            return np.zeros(UNSEEN_SAMPLES, bool)
        dense, along = _along_image(fit, camera, eye)
        place, here = np.interp(s, dense, along), np.interp(at, dense, along)
        limit = max(LEAST_GAP, GAP_FACTOR * np.median(np.diff(place)))
        after = np.clip(np.searchsorted(place, here), 1, len(s) - 1)
        near = np.minimum(np.abs(here - place[after - 1]), np.abs(place[after] - here))
        within = (here >= place[0]) & (here <= place[-1])
        shown &= (near <= 0.5 * limit) | ((place[after] - place[after - 1] <= limit) & within)
    return shown


def _places() -> Float64[np.ndarray, "g"]:
    return (np.arange(UNSEEN_SAMPLES) + 0.5) / UNSEEN_SAMPLES


def _along_image(
    fit: Refined, camera: RectifiedStereo, eye: int
) -> tuple[Float64[np.ndarray, "d"], Float64[np.ndarray, "d"]]:
    """Parameters of the curve, and the shares of its image's length in one eye that lie before them."""
    seen_px = pixels_evenly(fit.curve, DENSE, eye, camera, fit.row_offset_px)
    along = np.concatenate(([0.0], np.cumsum(chords(seen_px))))
    return even_parameters(fit.curve.spans, DENSE), along / max(along[-1], 1e-12)


def stretches(hidden: Bool[np.ndarray, "g"]) -> Float64[np.ndarray, "k 2"]:
    """Runs of true values among evenly spaced places, as intervals within 0 and 1."""
    edge = np.diff(np.concatenate(([0], hidden.astype(int), [0])))
    return np.column_stack((np.flatnonzero(edge == 1), np.flatnonzero(edge == -1))) / len(hidden)


def _stretches_turned(found: Float64[np.ndarray, "k 2"], reverse: bool) -> Float64[np.ndarray, "k 2"]:
    return np.clip(1.0 - found[::-1, ::-1], 0.0, 1.0) if reverse else found


def _turned(s: Float64[np.ndarray, "n"], reverse: bool) -> Float64[np.ndarray, "n"]:
    return np.clip(1.0 - s[::-1], 0.0, 1.0) if reverse else s
