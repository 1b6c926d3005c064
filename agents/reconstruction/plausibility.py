"""What cannot be reconstructed, and what is no reconstruction: each check gives its reason, empty where all is well."""

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.minimum_variation import DEGREE, MinimumVariationSpline
from schemas.messages import ThreadObservations
from shared.arc_length import length
from shared.camera import project
from shared.splines import evaluate

LEAST_OBSERVATIONS = DEGREE + 1
MOST_OBSERVATIONS = 1200
"""Time and memory grow with them. Perception makes some 100 and cannot make more: of clusters that hold a quarter of
a per cent of the pixels there are at most 400, and at most two ends are added to each."""
LEAST_DISPARITY_PX = 1e-3
LARGEST_DEPTH = 1e30
"""In the calibration's unit, and its inverse is the least: beyond that, squares leave the range of a float."""
LARGEST_MISSED_SHARE = 0.1
"""Of the observations: how many regions a curve may miss by more than the region's own size."""
LONGEST_SHARE = 3.0
"""A curve so many times as long as the chords between its observations is no thread but an accident."""


def unusable(observations: ThreadObservations) -> str:
    """Why no curve can be sought through these observations."""
    points, camera = observations.points_camera, observations.camera
    count = len(points)
    if count == 0 and not len(observations.matched_px):
        return (
            "these observations hold no matched pixels, which method 'paper' needs; set matching = true in "
            "[perception], or take method 'refined'"
        )
    if count < LEAST_OBSERVATIONS:
        return f"{count} observations are too few: a curve needs at least {LEAST_OBSERVATIONS}"
    if count > MOST_OBSERVATIONS:
        return f"{count} observations are too many: this method takes at most {MOST_OBSERVATIONS}; cluster more pixels"
    depth = points[:, 2]
    if depth.min() < 1 / LARGEST_DEPTH or depth.max() > LARGEST_DEPTH:
        return (
            f"depths from {depth.min():.3g} to {depth.max():.3g} cannot be computed with; check the calibration's unit"
        )
    size_px = np.array([camera.image_width, camera.image_height])
    with np.errstate(all="ignore"):
        left_px, right_px = project(camera, points)
        disparity_px = left_px[:, 0] - right_px[:, 0]
        near_image = (np.abs(left_px - 0.5 * size_px) <= size_px).all(axis=1)
        unseen = ~(near_image & (disparity_px >= LEAST_DISPARITY_PX) & (disparity_px <= 2 * camera.image_width))
    if unseen.any():
        j = int(np.argmax(unseen))
        return (
            f"observation {j} cannot have been seen by this camera (left pixel {left_px[j, 0]:.0f}, "
            f"{left_px[j, 1]:.0f}, disparity {disparity_px[j]:.3g}); check that its calibration is the images' own"
        )
    if not np.linalg.norm(np.diff(points, axis=0), axis=1).sum() > 0:
        return "all observations are at one place"
    return ""


def implausible(spline: MinimumVariationSpline, points: Float64[np.ndarray, "n 3"]) -> str:
    """Why this curve cannot be the thread."""
    if not np.isfinite(spline.control_points_camera).all():
        return "the solver returned numbers that are not finite"
    curve = evaluate(spline.knots, spline.control_points_camera, DEGREE, np.linspace(0, 1, 200))
    if curve[:, 2].min() <= 0:
        return "the curve passes behind the camera"
    chords = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    long = length(spline.knots, spline.control_points_camera, DEGREE)
    if long > LONGEST_SHARE * chords:
        return f"the curve is {long / chords:.1f} times as long as the way through its observations"
    return ""


def contradiction(spline: MinimumVariationSpline) -> str:
    """Why these observations belong to no single curve."""
    missed = spline.slack > 1.0
    if missed.mean() <= LARGEST_MISSED_SHARE:
        return ""
    return (
        f"{int(missed.sum())} of {len(missed)} observations contradict the others: no smooth curve comes near them in "
        "this order; the thread may cross itself, or strands may touch"
    )
