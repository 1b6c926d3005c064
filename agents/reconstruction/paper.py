"""Method `paper`: the published reconstruction, from ordered observations to a spline with confidence."""

import numpy as np
from jaxtyping import Float64

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
FLAT_M, DEVIATION_M = 0.003, 0.005
WORKING_DISTANCE_M = 0.1
STEEPEST = 0.3
"""How fast the thread may leave a known depth where nothing is measured, per length along it: some 17 degrees."""


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


def confidence_along(
    at: Float64[np.ndarray, "c"],
    regions_at: Float64[np.ndarray, "n"],
    bound_depth: Float64[np.ndarray, "n"],
    length: float,
    unit_m: float,
) -> Float64[np.ndarray, "c"]:
    """Confidence in [0, 1] at places along the thread: a Gaussian of the depth bounds (sections II-F and III).

    The whole extent of a region in depth, 2 ε_z, counts. Up to 3 mm it costs nothing, beyond that confidence falls with
    a standard deviation of 5 mm. Data in arbitrary units has no millimetres; there the same numbers are taken as shares
    of the working distance of 100 mm at which they were published.

    Interpolation alone would be sure of a long stretch without any region, such as thread along the image rows, because
    its two ends are well known. So the bound also grows with the distance to the nearest region that was measured.

    Args:
        at: places along the thread, as shares of its length.
        regions_at: places of the measured regions likewise, not decreasing.
        bound_depth: ε_z of each region in units of `unit_m` metres.
        length: of the thread, in the same unit.
        unit_m: metres per unit; for data in an arbitrary unit see `assumed_unit`.
    """
    with np.errstate(over="ignore"):
        unknown = STEEPEST * length * np.abs(at[:, None] - regions_at).min(axis=1)
        extent_m = 2.0 * (np.interp(at, regions_at, bound_depth) + unknown) * unit_m
        return np.exp(-0.5 * (np.maximum(extent_m - FLAT_M, 0.0) / DEVIATION_M) ** 2)


def assumed_unit(depth: Float64[np.ndarray, "n"]) -> float:
    """Metres per unit if the thread's median depth were the published working distance."""
    return WORKING_DISTANCE_M / float(np.median(depth))
