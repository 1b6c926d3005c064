"""What cannot be reconstructed, and what is no reconstruction: each check gives its reason, empty where all is well."""

import numpy as np

from agents.reconstruction.refined.alignment import Alignment
from agents.reconstruction.refined.refinement import Refined
from schemas.messages import Centrelines, RectifiedStereo, ThreadTrack

FEWEST_POINTS = 12
LEAST_MATCHED_SHARE = 0.3
"""Of the places where the left curve crosses the rows."""
LARGEST_RESIDUAL_SHARE = 0.004
"""Of the image's width, in the median: a curve farther from both centrelines is not theirs."""
LARGEST_NUMBER = 1e30
"""Of a calibration; so is its inverse the least. Beyond that, squares leave the range of a float."""
LEAST_SIZE_PX = 1e-6
FARTHEST_CENTRE = 1000.0
"""Of the image: no principal point, and no image of a thread that was followed, lies farther away."""
PLACES = np.linspace(0.0, 1.0, 200)
FARTHEST_SHARE = 1000.0
"""Of the baseline: beyond that, disparity is below what can be told from none."""


def unusable(left: Centrelines, right: Centrelines, camera: RectifiedStereo) -> str:
    """Why no curve can be sought in these centrelines."""
    size_px = np.array([camera.image_width, camera.image_height])
    for what in (camera.baseline, camera.fx_px, camera.fy_px, camera.metres_per_unit or 1.0):
        if not 1 / LARGEST_NUMBER <= what <= LARGEST_NUMBER:
            return f"a calibration with a length of {what:.3g} cannot be computed with; check its unit"
    if (np.abs((camera.cx_px, camera.cy_px)) > FARTHEST_CENTRE * size_px).any():
        return f"a principal point at ({camera.cx_px:.3g}, {camera.cy_px:.3g}) px is no camera's; check the calibration"
    for name, lines in (("left", left), ("right", right)):
        if len(lines.point_px) < FEWEST_POINTS:
            return (
                f"the {name} image shows too little thread: {len(lines.point_px)} px of centreline, "
                f"at least {FEWEST_POINTS} are needed"
            )
        if (np.abs(lines.point_px - 0.5 * size_px) > size_px).any():
            return f"the centreline of the {name} image lies outside of it"
        for what in (lines.width_px, lines.deviation_px):
            if what.min() < LEAST_SIZE_PX or what.max() > size_px.max():
                return f"no thread in the {name} image is {what.min():.3g} to {what.max():.3g} px wide or uncertain"
    return ""


def is_usable_track(track: ThreadTrack, camera: RectifiedStereo) -> bool:
    """Whether a track's numbers are those of a thread, so that a next frame can be predicted from them."""
    points = track.control_points_camera
    if points[:, 2].min() < camera.baseline / LARGEST_NUMBER or np.abs(points).max() > camera.baseline * LARGEST_NUMBER:
        return False
    # without dividing by a depth that is next to nothing
    if (np.abs(points[:, :2]) * camera.fx_px > FARTHEST_CENTRE * camera.image_width * points[:, 2:]).any():
        return False
    size = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    rows = np.append(track.row_offset_px, () if track.row_slopes_px is None else track.row_slopes_px)
    told = (
        (track.length, 1e-3 * size, 1e3 * size),
        (float(np.diff(track.material_s)[0]), 1e-6, 1e6),
        (1.0 + float(np.abs(track.material_s).max()), 0.0, 1e6),
        (track.smoothing, 1 / LARGEST_NUMBER, LARGEST_NUMBER),
        (float(track.span_weight.min()), 1 / LARGEST_NUMBER, LARGEST_NUMBER),
        (float(track.span_weight.max()), 1 / LARGEST_NUMBER, LARGEST_NUMBER),
        (float(np.sqrt(np.abs(track.covariance).max())), 0.0, 1e6 * size),
        (float(np.abs(rows).max()), 0.0, float(camera.image_width)),
    )
    return all(low <= value <= high for value, low, high in told)


def contradiction(aligned: Alignment | None, camera: RectifiedStereo) -> str:
    """Why the two images do not show one thread."""
    remedy = (
        "check that both images show the same thread, that left and right are not exchanged, and that the "
        "calibration is the images' own"
    )
    if aligned is None:
        return f"no place of the thread in the left image has a counterpart in its row of the right image; {remedy}"
    if aligned.share < LEAST_MATCHED_SHARE:
        return f"only {aligned.share:.0%} of the thread in the left image has a counterpart in the right one; {remedy}"
    if np.median(aligned.disparity_px) <= camera.fx_px / FARTHEST_SHARE:
        return f"the thread would be more than {FARTHEST_SHARE:.0f} baselines away; {remedy}"
    return ""


def implausible(fit: Refined, camera: RectifiedStereo) -> str:
    """Why this curve cannot be the thread."""
    if not np.isfinite(fit.curve.control_points).all():
        return "the fit to both images diverged"
    depth = fit.curve.at(PLACES)[:, 2]
    if depth.min() <= 0:
        return "the curve passes behind the camera"
    across_px = np.abs(fit.rows.residual[: fit.rows.sightings]) * fit.sight.deviation_px
    for name, eye in (("left", 0), ("right", 1)):
        here = across_px[fit.sight.eye == eye]
        limit = LARGEST_RESIDUAL_SHARE * camera.image_width
        if len(here) and np.median(here) > limit:
            return (
                f"the two images contradict each other: the curve is {np.median(here):.1f} px from the thread in the "
                f"{name} image; check the calibration"
            )
    return ""
