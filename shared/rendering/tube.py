"""Anti-aliased pixels of a tube around a centreline, by distance to the projected polyline.

A tube of radius r around a point P that projects to u_P shows, across the image direction n, the half width

    ρ = r √((fx nx)² + (fy ny)² + (n·(u_P − c))²) / z

since the plane through the camera and the silhouette line n·u = n·u_P + ρ has the distance r from P. A pixel is a
unit square, and a straight edge cuts it to an area that is the integral of a trapezoid as wide as the square's
shadow on n. So coverage is exact for straight stretches, and its centroid is the projected centreline.

Pixels are kept as a sparse list, strand by strand, so that a nearer strand lies over a farther one.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64

from schemas.messages import RectifiedStereo
from shared.camera import camera_matrix
from shared.rendering.centreline import NEAR_MM, Centreline

STRAND_GAP_PX = 12.0
"""Segments that meet in one pixel this far apart along the projected centreline belong to two strands."""

FACING_SLANT = 0.1
"""Where the thread's end slants less than this against the line of sight, it is seen as a disc, and not cut."""

DEPTH_STEP_PX = 1.0 / 512.0
SEGMENT_BITS = 24
SEGMENT_MASK = (1 << SEGMENT_BITS) - 1
"""A segment's claim to a pixel as one integer: how deep inside its stretch of tube the pixel lies, and which it is."""


@dataclass(frozen=True)
class TubePixels:
    """Pixels that a tube touches in one image, each strand for itself, farther strands first.

    Fields:
        flat: index into the image's pixels, row by row; a pixel at a crossing comes once for each strand.
        coverage: share of the pixel's square within the silhouette, 0 to 1.
        across: place between the silhouette's edges, −1 to 1, positive to the right of the direction of travel.
        depth_mm: depth of the centreline beneath the pixel; arc_mm: its arc length from the start.
        slant: sine of the angle between the thread and the line of sight, 0 where it points at the camera.
    """

    flat: Int64[np.ndarray, "n"]
    coverage: Float64[np.ndarray, "n"]
    across: Float64[np.ndarray, "n"]
    depth_mm: Float64[np.ndarray, "n"]
    arc_mm: Float64[np.ndarray, "n"]
    slant: Float64[np.ndarray, "n"]


@dataclass(frozen=True)
class _Polyline:
    """Projected segments: start, step, radius in pixels at both ends, way travelled, and the sample each starts from.

    `first` and `last` say whether the thread's own ends are drawn, to be cut straight.
    """

    start: Float64[np.ndarray, "n 2"]
    step: Float64[np.ndarray, "n 2"]
    radius_px: Float64[np.ndarray, "n 2"]
    travelled_px: Float64[np.ndarray, "n"]
    sample: Int64[np.ndarray, "n"]
    first: bool
    last: bool


def tube_pixels(camera: RectifiedStereo, centreline: Centreline, radius_mm: float) -> TubePixels:
    """The pixels of a tube in the camera in whose frame the centreline is given; none where it is out of view."""
    line = _project(camera, centreline, radius_mm)
    flat, segment = _nearest_segments(line, camera.image_width, camera.image_height)
    pixels = np.column_stack((flat % camera.image_width, flat // camera.image_width)).astype(np.float64)
    return _ordered_by_depth(_measure(line, centreline, flat, segment, pixels))


def coverage_image(camera: RectifiedStereo, tube: TubePixels) -> Float32[np.ndarray, "h w"]:
    """The share of every pixel that the tube covers, strands taken together."""
    clear = np.ones(camera.image_height * camera.image_width, dtype=np.float32)
    np.multiply.at(clear, tube.flat, (1.0 - tube.coverage).astype(np.float32))
    return (1.0 - clear).reshape(camera.image_height, camera.image_width)


def edge_coverage(
    distance_px: Float64[np.ndarray, "n"], normal_px: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "n"]:
    """Area of a unit square on the inner side of a straight edge that lies `distance_px` outside its centre."""
    # a shadow of exactly zero width would divide by zero; a thousandth of a pixel changes nothing
    wide, narrow = np.maximum(np.abs(normal_px), 1e-3).T
    outer, inner = 0.5 * (wide + narrow), 0.5 * (wide - narrow)
    ramps = (
        np.maximum(distance_px + outer, 0.0) ** 2
        - np.maximum(distance_px + inner, 0.0) ** 2
        - np.maximum(distance_px - inner, 0.0) ** 2
        + np.maximum(distance_px - outer, 0.0) ** 2
    )
    return np.clip(ramps / (2.0 * wide * narrow), 0.0, 1.0)


def _project(camera: RectifiedStereo, centreline: Centreline, radius_mm: float) -> _Polyline:
    points = centreline.points_camera
    drawn = (points[:-1, 2] > NEAR_MM) & (points[1:, 2] > NEAR_MM)
    sample = np.flatnonzero(drawn)
    K = camera_matrix(camera)
    focal, centre = K[[0, 1], [0, 1]], K[:2, 2]
    depth = np.maximum(points[:, 2:], NEAR_MM)
    pixels = points[:, :2] / depth * focal + centre
    start = pixels[sample]
    step = pixels[sample + 1] - start
    normal = _normals(step)
    # the tube's silhouette is as far from its axis as the plane's normal, in camera axes, is long
    stretch = np.sqrt(_dot(normal * focal, normal * focal) + _dot(normal, start - centre) ** 2)
    ends = np.column_stack((depth[sample, 0], depth[sample + 1, 0]))
    length = np.hypot(step[:, 0], step[:, 1])
    radius = radius_mm * stretch[:, None] / ends
    slanting = _slant(centreline.tangents_camera[[0, -1]], points[[0, -1]]) > FACING_SLANT
    first, last = (slanting & drawn[[0, -1]]).tolist()
    return _Polyline(start, step, radius, np.cumsum(length), sample, first, last)


def _nearest_segments(
    line: _Polyline, width: int, height: int
) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
    """Every pixel within reach, with the segment it is deepest inside of; once for each strand that is near."""
    inside = (line.start > -30.0).all(axis=1) & (line.start < (width + 30.0, height + 30.0)).all(axis=1)
    chosen = np.flatnonzero(inside)
    if not len(chosen):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    reach = int(np.ceil(line.radius_px[chosen].max() + 1.5))
    return _deepest_of_each_strand(line, *_candidates(line, chosen, reach, width, height))


def _candidates(
    line: _Polyline, chosen: Int64[np.ndarray, "c"], reach: int, width: int, height: int
) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"], Float32[np.ndarray, "n"]]:
    """Pixels of a square patch around each chosen segment that its stretch of tube may touch."""
    window = np.arange(-reach, reach + 1)
    du, dv = (axis.ravel() for axis in np.meshgrid(window, window))
    start, step = line.start[chosen], line.step[chosen]
    base = np.rint(start + 0.5 * step).astype(np.int64)
    offset = (base - start).astype(np.float32)
    x = du.astype(np.float32) + offset[:, :1]
    y = dv.astype(np.float32) + offset[:, 1:]
    a, b = step.astype(np.float32).T[:, :, None]
    # the open ends carry on straight, and are cut off when coverage is measured
    low = np.where((line.first & (chosen == 0)), -np.inf, 0.0).astype(np.float32)[:, None]
    high = np.where(line.last & (chosen == len(line.start) - 1), np.inf, 1.0).astype(np.float32)[:, None]
    t = (x * a + y * b) * (1.0 / np.maximum(a * a + b * b, np.float32(1e-9)))
    np.minimum(np.maximum(t, low, out=t), high, out=t)
    x -= t * a
    y -= t * b
    square = x * x + y * y
    radius = line.radius_px[chosen].max(axis=1).astype(np.float32)
    row, place = np.nonzero(square < (radius[:, None] + 1.0) ** 2)
    u, v = base[row, 0] + du[place], base[row, 1] + dv[place]
    seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    row, place = row[seen], place[seen]
    return v[seen] * width + u[seen], chosen[row], radius[row] - np.sqrt(square[row, place])


def _deepest_of_each_strand(
    line: _Polyline,
    flat: Int64[np.ndarray, "c"],
    segment: Int64[np.ndarray, "c"],
    inside: Float32[np.ndarray, "c"],
) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
    """Of the candidates for a pixel, that which each strand covers most deeply.

    Candidates compete for their pixel; those of another strand than the winner's compete again, until none is left.
    """
    depth = np.rint((inside + 1.0) / DEPTH_STEP_PX).astype(np.int64)
    claim = depth << SEGMENT_BITS | segment
    # a pixel within a thick tube is in reach of segments as far apart as the tube is wide
    gap = max(STRAND_GAP_PX, 4.0 * float(line.radius_px.max(initial=0.0)))
    highest = np.full(int(flat.max(initial=-1)) + 1, -1, dtype=np.int64)
    won_flat, won_segment = [flat[:0]], [segment[:0]]
    while len(flat):
        highest[flat] = -1
        np.maximum.at(highest, flat, claim)
        winner = highest[flat]
        won = claim == winner
        won_flat.append(flat[won])
        won_segment.append(segment[won])
        way = line.travelled_px[segment] - line.travelled_px[winner & SEGMENT_MASK]
        other = np.abs(way) > gap
        flat, segment, claim = flat[other], segment[other], claim[other]
    return np.concatenate(won_flat), np.concatenate(won_segment)


def _measure(
    line: _Polyline,
    centreline: Centreline,
    flat: Int64[np.ndarray, "n"],
    segment: Int64[np.ndarray, "n"],
    pixels: Float64[np.ndarray, "n 2"],
) -> TubePixels:
    """Coverage and the rest for pixels whose segments are known."""
    step = line.step[segment]
    relative = pixels - line.start[segment]
    free = _dot(relative, step) / np.maximum(_dot(step, step), 1e-12)
    t = np.clip(free, 0.0, 1.0)
    normal = _normals(step)
    first = line.first & (segment == 0) & (free < 0)
    last = line.last & (segment == len(line.start) - 1) & (free > 1)
    foot = relative - np.where(first | last, free, t)[:, None] * step
    offset = _dot(foot, normal)
    distance = np.copysign(np.hypot(foot[:, 0], foot[:, 1]), offset)
    radius = line.radius_px[segment, 0] * (1 - t) + line.radius_px[segment, 1] * t
    coverage = edge_coverage(radius - distance, normal) + edge_coverage(radius + distance, normal) - 1.0
    sample = line.sample[segment]
    slant = _slant(centreline.tangents_camera[sample], centreline.points_camera[sample])
    depth, arc = centreline.points_camera[:, 2], centreline.arc_mm
    return TubePixels(
        flat,
        np.clip(coverage * _cut_at_ends(line, segment, relative), 0.0, 1.0),
        np.clip(distance / np.maximum(radius, 1e-9), -1.0, 1.0),
        depth[sample] * (1 - t) + depth[sample + 1] * t,
        arc[sample] * (1 - t) + arc[sample + 1] * t,
        slant,
    )


def _cut_at_ends(
    line: _Polyline,
    segment: Int64[np.ndarray, "n"],
    relative: Float64[np.ndarray, "n 2"],
) -> Float64[np.ndarray, "n"]:
    """What a straight cut through each end of the thread leaves of its pixels."""
    left = np.ones(len(segment))
    ends = [(0, 1.0)] * line.first + [(len(line.start) - 1, -1.0)] * line.last
    for index, sign in ends:
        way = np.abs(line.travelled_px[segment] - line.travelled_px[index])
        near = np.flatnonzero(way < STRAND_GAP_PX)
        step = line.step[index]
        direction = step / max(float(np.hypot(*step)), 1e-12)
        end = line.start[index] + (step if sign < 0 else 0.0)
        inward = sign * ((relative[near] + line.start[segment[near]] - end) @ direction)
        left[near] = edge_coverage(inward, np.broadcast_to(direction, (len(near), 2)))
    return left


def _ordered_by_depth(tube: TubePixels) -> TubePixels:
    order = np.flatnonzero(tube.coverage > 0)
    # hundredths of a millimetre tell strands apart, and one key sorts faster than two
    nearness = np.rint(100.0 * tube.depth_mm.max(initial=0.0) - 100.0 * tube.depth_mm[order]).astype(np.int64)
    order = order[np.argsort((tube.flat[order] << 32) + nearness)]
    return TubePixels(
        tube.flat[order],
        tube.coverage[order],
        tube.across[order],
        tube.depth_mm[order],
        tube.arc_mm[order],
        tube.slant[order],
    )


def _slant(tangent: Float64[np.ndarray, "n 3"], sight: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
    """Sine of the angle between tangents and lines of sight."""
    lengths = np.sqrt(_dot(tangent, tangent) * _dot(sight, sight))
    along = _dot(tangent, sight) / np.maximum(lengths, 1e-12)
    return np.sqrt(np.maximum(1.0 - along**2, 0.0))


def _dot(a: Float64[np.ndarray, "n d"], b: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "n"]:
    """Inner products row by row."""
    return np.einsum("ij,ij->i", a, b)


def _normals(step: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """Unit normals to the right of the direction of travel as the image shows it (v points down)."""
    length = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-12)
    return np.column_stack((-step[:, 1], step[:, 0])) / length[:, None]
