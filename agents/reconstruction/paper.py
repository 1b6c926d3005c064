"""Method `paper`: the published reconstruction, from ordered observations to a spline with confidence."""

import numpy as np

from agents.reconstruction.confidence import assumed_unit, confidence_along
from agents.reconstruction.minimum_variation import (
    DEGREE,
    MinimumVariationSpline,
    Regions,
    UnsolvedError,
    chord_parameters,
    constant_speed_parameters,
    minimum_variation_spline,
)
from agents.reconstruction.plausibility import contradiction, implausible, unusable
from agents.reconstruction.regions import fit_depth, image_bounds, is_borrowed
from schemas.messages import ReliabilityRegions, Status, ThreadObservations, ThreadReconstruction
from shared.arc_length import length

METHOD = "paper"
CONFIDENCE_SAMPLES = 100


def reconstruct_paper(observations: ThreadObservations) -> ThreadReconstruction:
    """The minimum-variation spline through the reliability regions of these observations.

    Never raises for any valid observations: a failure is a status with its reason.
    """
    if observations.status is not Status.OK:
        return failed(observations, METHOD, observations.reason)
    reason = unusable(observations)
    if reason:
        return failed(observations, METHOD, reason)
    camera, points = observations.camera, observations.points_camera
    fit = fit_depth(points, camera)
    regions = Regions(
        centre_camera=points,
        bound_px=image_bounds(observations.half_size_px, camera.image_width),
        bound_depth=fit.bound,
    )
    # Depths come in steps of a whole pixel of disparity, and chords count each step twice over: s starts from the
    # chords between observations moved along their rays to the fitted depth.
    smoothed = points * (fit.depth / points[:, 2])[:, None]
    try:
        spline = minimum_variation_spline(regions, camera, chord_parameters(smoothed))
    except UnsolvedError as error:
        return failed(observations, METHOD, str(error))
    reason = contradiction(spline) or implausible(spline, points)
    if reason:
        return failed(observations, METHOD, reason)
    return _result(observations, regions, spline)


def failed(observations: ThreadObservations, method: str, reason: str) -> ThreadReconstruction:
    """A reconstruction without a curve, and why."""
    none = np.zeros(0)
    return ThreadReconstruction(
        stamp=observations.stamp,
        camera=observations.camera,
        status=Status.FAILED,
        reason=reason,
        method=method,
        degree=DEGREE,
        knots=none,
        control_points_camera=np.zeros((0, 3)),
        regions=ReliabilityRegions(none, np.zeros((0, 3)), np.zeros((0, 2)), none, none),
        confidence_s=none,
        confidence=none,
    )


def _result(observations: ThreadObservations, regions: Regions, spline: MinimumVariationSpline) -> ThreadReconstruction:
    knots, control_points = spline.knots, spline.control_points_camera
    regions_at = constant_speed_parameters(knots, control_points, spline.s)
    measured = ~is_borrowed(len(regions_at), observations.gaps)
    if not measured.any():
        measured = ~measured
    at = np.linspace(0.0, 1.0, CONFIDENCE_SAMPLES)
    unit_m = observations.camera.metres_per_unit or assumed_unit(observations.points_camera[:, 2])
    return ThreadReconstruction(
        stamp=observations.stamp,
        camera=observations.camera,
        status=Status.OK,
        reason="",
        method=METHOD,
        degree=DEGREE,
        knots=knots,
        control_points_camera=control_points,
        regions=ReliabilityRegions(
            spline.s, regions.centre_camera, regions.bound_px, regions.bound_depth, spline.slack
        ),
        confidence_s=at,
        confidence=confidence_along(
            at, regions_at[measured], regions.bound_depth[measured], length(knots, control_points, DEGREE), unit_m
        ),
        unseen=np.column_stack((regions_at[observations.gaps], regions_at[observations.gaps + 1])),
    )
