"""The tissue as a height field along the viewing rays, and how far points are before it.

Of a plane in space the inverse of the depth is affine in the pixel, so that is what is interpolated: between the cells
of the grid, and first across single cells that were not measured, which is what the thread itself leaves in its wake.
A cell is filled where the two cells beside it are known, one or two cells away on a row, a column or a diagonal. How
sure that is, the cells tell that were measured: the same is done to each of them, and the mean square of what comes
out wrong is the variance of a cell that is filled. Beyond that nothing is made up: unknown stays unknown.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from schemas.messages import RectifiedStereo, TissueSurface

WAYS_ACROSS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Row, column, and both diagonals."""
FARTHEST_CELLS = 2


@dataclass(frozen=True)
class Tissue:
    """A surface in metres.

    Fields:
        u_px, v_px: the middles of the grid's columns and rows.
        inverse_depth: of the surface there, in 1/m; NaN where it is not known.
        deviation: its standard deviation; NaN likewise.
    """

    camera: RectifiedStereo
    u_px: Float64[np.ndarray, "c"]
    v_px: Float64[np.ndarray, "r"]
    inverse_depth: Float64[np.ndarray, "r c"]
    deviation: Float64[np.ndarray, "r c"]


def tissue_of(surface: TissueSurface, hidden: Bool[np.ndarray, "r c"] | None = None) -> Tissue | None:
    """The tissue of a surface in metres, with small holes filled; None where it tells no unit, deviation or cell.

    Args:
        hidden: cells of which nothing is known, whatever the surface tells.
    """
    unit_m = surface.camera.metres_per_unit
    valid = surface.valid if hidden is None else surface.valid & ~hidden
    if unit_m is None or surface.deviation is None or min(surface.depth.shape) < 2 or not valid.any():
        return None
    depth_m = np.where(valid, unit_m * surface.depth, np.nan)
    inverse_depth = 1.0 / depth_m
    deviation = unit_m * surface.deviation * inverse_depth**2
    return Tissue(surface.camera, surface.u_px, surface.v_px, *_filled(inverse_depth, deviation))


def clearance(
    tissue: Tissue, points_camera: Float64[np.ndarray, "*n 3"]
) -> tuple[Float64[np.ndarray, "*n"], Float64[np.ndarray, "*n"]]:
    """How far the tissue is behind points, along their viewing rays in metres, and its standard deviation.

    Negative where a point is in the tissue; NaN where the tissue before or behind it is not known.
    """
    z = np.where(points_camera[..., 2] > 0, points_camera[..., 2], np.nan)
    u = tissue.camera.fx_px * points_camera[..., 0] / z + tissue.camera.cx_px
    v = tissue.camera.fy_px * points_camera[..., 1] / z + tissue.camera.cy_px
    inverse_depth, deviation = _interpolated(tissue, u, v)
    # from depth to distance along the ray
    oblique = np.linalg.norm(points_camera, axis=-1) / z
    return oblique * (1.0 / inverse_depth - z), oblique * deviation / inverse_depth**2


def _interpolated(
    tissue: Tissue, u: Float64[np.ndarray, "*n"], v: Float64[np.ndarray, "*n"]
) -> tuple[Float64[np.ndarray, "*n"], Float64[np.ndarray, "*n"]]:
    """Inverse depth and deviation between four cells; NaN where one of them is not known, and outside of the grid."""
    column, right = _between(tissue.u_px, u)
    row, below = _between(tissue.v_px, v)
    weights = (1 - below) * (1 - right), (1 - below) * right, below * (1 - right), below * right
    corners = (row, column), (row, column + 1), (row + 1, column), (row + 1, column + 1)
    inverse_depth, deviation = np.zeros(u.shape), np.zeros(u.shape)
    for weight, corner in zip(weights, corners, strict=True):
        inverse_depth += weight * tissue.inverse_depth[corner]
        # errors of cells side by side go together, since matching hands them on
        deviation += weight * tissue.deviation[corner]
    return inverse_depth, deviation


def _between(
    middles: Float64[np.ndarray, "c"], at: Float64[np.ndarray, "*n"]
) -> tuple[np.ndarray, Float64[np.ndarray, "*n"]]:
    """The cell before each place, and what share of the way to the next it lies beyond; NaN outside of the grid."""
    inside = (at >= middles[0]) & (at <= middles[-1])
    place = np.interp(np.where(inside, at, middles[0]), middles, np.arange(len(middles)))
    before = np.minimum(place.astype(np.intp), len(middles) - 2)
    return before, np.where(inside, place - before, np.nan)


def _filled(
    inverse_depth: Float64[np.ndarray, "r c"], deviation: Float64[np.ndarray, "r c"]
) -> tuple[Float64[np.ndarray, "r c"], Float64[np.ndarray, "r c"]]:
    """The grid with each unknown cell between two known ones filled, by those across the shortest way."""
    filled, unsure = inverse_depth.copy(), deviation.copy()
    for cells in range(1, FARTHEST_CELLS + 1):
        means = np.stack([_mean_across(inverse_depth, cells * down, cells * along) for down, along in WAYS_ACROSS])
        count = np.isfinite(means).sum(axis=0)
        mean = np.nansum(means, axis=0) / np.where(count, count, np.nan)
        off = (mean - inverse_depth)[np.isfinite(mean) & np.isfinite(inverse_depth)]
        # nothing tells how wrong a mean is where none can be compared
        typical = float(np.sqrt(np.mean(off**2))) if len(off) else np.nan
        empty = np.isnan(filled) & np.isfinite(mean) & np.isfinite(typical)
        filled[empty], unsure[empty] = mean[empty], typical
    return filled, unsure


def _mean_across(values: Float64[np.ndarray, "r c"], down: int, along: int) -> Float64[np.ndarray, "r c"]:
    """The mean of the two cells that lie so far away on either side of each; NaN where one is unknown or outside."""
    rows, columns = values.shape
    padded = np.full((rows + 2 * down, columns + 2 * abs(along)), np.nan)
    padded[down : down + rows, abs(along) : abs(along) + columns] = values

    def moved(way: int) -> Float64[np.ndarray, "r c"]:
        top, left = down + way * down, abs(along) + way * along
        return padded[top : top + rows, left : left + columns]

    return 0.5 * (moved(1) + moved(-1))
