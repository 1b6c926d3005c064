"""Reliability regions of matched places, as of the paper (eq. 4), and how far the curve misses each.

A region stands where a place of the left centreline was matched: half the thread's width about the left point, and the
disparity within some deviations of its match. All points of both centrelines have their say in the fit; a region that
the curve misses is a match that they contradict.
"""

import numpy as np
from jaxtyping import Float64

from agents.reconstruction.minimum_variation import Regions, region_faces
from agents.reconstruction.refined.alignment import Alignment
from agents.reconstruction.refined.paths import Chain
from agents.reconstruction.refined.projection import Curve
from schemas.messages import RectifiedStereo
from shared.camera import backproject, depth_of_disparity

MOST_REGIONS = 60
DEVIATIONS = 4.0
LEAST_BOUND_PX = 1.0
LEAST_DISPARITY_BOUND_PX = 0.5
LARGEST_DEPTH_SHARE = 0.5


def matched_regions(
    left: Chain, aligned: Alignment, camera: RectifiedStereo
) -> tuple[Regions, Float64[np.ndarray, "n"]]:
    """The regions of matched places, and their share of the way along the left chain."""
    chosen = np.unique(np.linspace(0, len(aligned.along_px) - 1, MOST_REGIONS).round().astype(int))
    at, disparity = aligned.along_px[chosen], aligned.disparity_px[chosen]
    pixel = np.column_stack([np.interp(at, left.along_px, left.point_px[:, axis]) for axis in (0, 1)])
    half = 0.5 * np.interp(at, left.along_px, left.width_px) + LEAST_BOUND_PX
    depth = depth_of_disparity(camera, disparity)
    reach = np.maximum(DEVIATIONS * np.sqrt(aligned.variance_px2[chosen]), LEAST_DISPARITY_BOUND_PX)
    bound = np.minimum(depth * reach / disparity, LARGEST_DEPTH_SHARE * depth)
    regions = Regions(backproject(camera, pixel, depth), np.column_stack((half, half)), bound)
    return regions, at / left.along_px[-1]


def slack_of(
    regions: Regions, s: Float64[np.ndarray, "n"], curve: Curve, camera: RectifiedStereo
) -> Float64[np.ndarray, "n"]:
    """How far the curve's points at s lie outside of their regions, in the regions' own bounds; 0 inside."""
    faces = region_faces(regions, camera, np.zeros(3), 1.0)
    return (np.einsum("nij,nj->ni", faces.normal, curve.at(s)) + faces.offset).max(axis=1).clip(0.0)
