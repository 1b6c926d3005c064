"""Reliability regions of the refined curve, and the quadratic program that keeps it inside (paper, eq. 4 and 5).

A region stands where a place of the left centreline was matched: half the thread's width about the left point, and the
disparity within some deviations of its match. The refined curve lies inside nearly always, and then it is also the
solution of Gauss-Newton's quadratic program under the regions; where it does not, that program is solved (PIQP), each
region with a slack that widens it at a price.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float64

from agents.reconstruction.minimum_variation import (
    NEGLIGIBLE_SLACK,
    Regions,
    inequality_matrix,
    program_solution,
    region_faces,
)
from agents.reconstruction.refined.alignment import Alignment
from agents.reconstruction.refined.normal_equations import Blocks, band, gradient
from agents.reconstruction.refined.paths import Chain
from agents.reconstruction.refined.projection import DEGREE, Curve
from schemas.messages import RectifiedStereo
from shared.camera import backproject, depth_of_disparity
from shared.splines import basis_matrix

MOST_REGIONS = 60
DEVIATIONS = 4.0
LEAST_BOUND_PX = 1.0
LEAST_DISPARITY_BOUND_PX = 0.5
LARGEST_DEPTH_SHARE = 0.5
SLACK_PRICE = 10.0
"""Of a region's own size, in units of the points' log likelihood: a match that many points contradict gives way."""


@dataclass(frozen=True)
class Held:
    """A curve, the regions at s that it was held to, and the slack of each."""

    curve: Curve
    regions: Regions
    s: Float64[np.ndarray, "n"]
    slack: Float64[np.ndarray, "n"]


def regions_of(left: Chain, aligned: Alignment, camera: RectifiedStereo) -> tuple[Regions, Float64[np.ndarray, "n"]]:
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


def held_to(
    regions: Regions, s: Float64[np.ndarray, "n"], curve: Curve, total: Blocks, camera: RectifiedStereo
) -> Held:
    """The curve, moved into the regions where it lies outside, and the slack of each.

    Raises:
        UnsolvedError: where the program has no solution that the solver can vouch for.
    """
    centre = curve.control_points.mean(axis=0)
    faces = region_faces(regions, camera, centre, curve.size)
    basis = basis_matrix(curve.knots, DEGREE, s)
    scaled = (curve.control_points - centre) / curve.size
    value = np.einsum("nij,nj->ni", faces.normal, basis @ scaled) + faces.offset
    if (value <= 0).all():
        return Held(curve, regions, s, np.zeros(len(s)))
    H, g = _dense(total), gradient(total.g)
    n, variables = len(s), scaled.size
    give = scipy.sparse.kron(scipy.sparse.eye(n), -np.ones((6, 1)))
    C = inequality_matrix(basis, faces)
    x = program_solution(
        scipy.sparse.csc_matrix(scipy.sparse.block_diag((H * curve.size**2, scipy.sparse.csc_matrix((n, n))))),
        np.concatenate((g * curve.size, np.full(n, SLACK_PRICE))),
        scipy.sparse.csc_matrix(scipy.sparse.hstack((C, give))),
        -value.ravel(),
        np.concatenate((np.full(variables, -np.inf), np.zeros(n))),
    )
    slack = np.where(x[variables:] > NEGLIGIBLE_SLACK, x[variables:], 0.0)
    return Held(curve.moved(curve.size * x[:variables].reshape(-1, 3)), regions, s, slack)


def _dense(total: Blocks) -> Float64[np.ndarray, "v v"]:
    lower = band(total)
    size = lower.shape[1]
    H = np.zeros((size, size))
    for offset, diagonal in enumerate(lower):
        H[np.arange(offset, size), np.arange(size - offset)] = diagonal[: size - offset]
        H[np.arange(size - offset), np.arange(offset, size)] = diagonal[: size - offset]
    return H
