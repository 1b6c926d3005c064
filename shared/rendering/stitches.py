"""A thread through two holes in the tissue: what lies on either side of the bite, and how it looks.

One strand ends free, the tail; the other is the standing one, which is pulled. Both begin at a hole, and between the
holes the thread is within the tissue, where nobody sees it. Millimetres, in the left camera's frame.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.rendering.backdrop_files import Backdrop
from shared.rendering.centreline import Thread
from shared.rendering.render import View, render_thread
from shared.rendering.surface import Surface, depth_at_points
from shared.rendering.thread_shapes import ShapeError, fitted

GAP_MM = (3.0, 10.0)
TAIL_MM, STANDING_MM = (25.0, 70.0), (60.0, 120.0)
RADIUS_MM = (0.15, 0.25)
KNOTTED_SHARE, KNOT_MM = 0.25, (1.0, 30.0)
"""How many tails have a knot, and how far from their end."""
SPACING_MM = 1.0
CONTROL_SPACING_MM = 2.5
MARGIN_PX = 24.0
APART_MM = 3.0
"""How near strands lie to each other at least, beyond so much of their length; they do not cross."""
NEIGHBOURS_MM = 10.0
BEND_RAD = 1.3
"""By how much a strand leaves its hole otherwise than along the line through both."""
DRAWS = 2000
HOLE_RADII = 2.2
"""Of the dark spot around a hole, in radii of the thread."""
HOLE_SHADE = 0.55


@dataclass(frozen=True)
class Stitch:
    """A thread through tissue before it is pulled.

    Fields:
        tail, standing: points along either strand, each from its hole to its end, SPACING_MM apart.
        knot_mm: how far from the tail's end there is a knot, which does not go through the hole; None without one.
    """

    tail: Float64[np.ndarray, "n 3"]
    standing: Float64[np.ndarray, "m 3"]
    radius_mm: float
    knot_mm: float | None = None

    @property
    def holes(self) -> Float64[np.ndarray, "2 3"]:
        """Where the thread goes into the tissue from the tail, and where it comes out as the standing strand."""
        return np.stack((self.tail[0], self.standing[0]))


def stitch_on(camera: RectifiedStereo, surface: Surface, seed: int) -> Stitch:
    """A stitch inside both images, with a margin, drawn by a seed.

    Raises:
        ShapeError: where none fits into the view.
    """
    rng = np.random.default_rng([seed, 31])
    radius = float(rng.uniform(*RADIUS_MM))
    knot = float(rng.uniform(*KNOT_MM)) if rng.uniform() < KNOTTED_SHARE else None
    gap, tail_mm, standing_mm = (float(rng.uniform(*limits)) for limits in (GAP_MM, TAIL_MM, STANDING_MM))
    for _ in range(DRAWS):
        tail, standing = _drawn(rng, gap, tail_mm, standing_mm)
        if _lies_apart(tail, standing):
            middle = _place(camera, surface, rng, np.concatenate((tail, standing)))
            tail, standing = tail + middle, standing + middle
            tail, standing = (_on(surface, path, radius) for path in (tail, standing))
            if _is_inside(camera, tail) and _is_inside(camera, standing):
                return Stitch(tail, standing, radius, knot)
    raise ShapeError("found no stitch that fits into both images at this distance; use a wider or more distant view")


def strand_thread(points: Float64[np.ndarray, "n 3"], radius_mm: float) -> Thread | None:
    """The spline along a strand, as the renderer draws it; None where nothing is left of the strand."""
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if chords.sum() < 4.0 * radius_mm:
        return None
    way = np.concatenate(([0.0], np.cumsum(chords)))
    even = np.linspace(0.0, way[-1], max(round(4.0 * way[-1] / CONTROL_SPACING_MM), 40))
    return fitted(np.column_stack([np.interp(even, way, axis) for axis in points.T]), CONTROL_SPACING_MM, radius_mm)


def render_strands(
    camera: RectifiedStereo,
    strands: tuple[Thread | None, ...],
    holes: Float64[np.ndarray, "h 3"],
    radius_mm: float,
    colour: str,
    backdrop: Backdrop,
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """Left and right image of strands over a backdrop, the later ones over the earlier, with dark holes beneath."""
    eyes = ((backdrop.left_bgr, 0.0), (backdrop.right_bgr, camera.baseline))
    left, right = (_with_holes(image, camera, holes, radius_mm, eye_x_mm) for image, eye_x_mm in eyes)
    for strand in strands:
        if strand is not None:
            views: tuple[View, View] = render_thread(
                camera, strand, colour, replace(backdrop, left_bgr=left, right_bgr=right)
            )
            left, right = views[0].bgr, views[1].bgr
    return left, right


def _with_holes(
    image: UInt8[np.ndarray, "h w 3"],
    camera: RectifiedStereo,
    holes: Float64[np.ndarray, "h 3"],
    radius_mm: float,
    eye_x_mm: float,
) -> UInt8[np.ndarray, "h w 3"]:
    image = image.copy()
    pixels, _ = project(camera, holes - (eye_x_mm, 0.0, 0.0))
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]] if len(holes) else (None, None)
    for (u, v), depth in zip(pixels, holes[:, 2], strict=True):
        size = HOLE_RADII * radius_mm * camera.fx_px / depth
        reach = int(4 * size)
        top, side = max(round(v) - reach, 0), max(round(u) - reach, 0)
        window = np.s_[top : max(round(v) + reach, 0), side : max(round(u) + reach, 0)]
        assert rows is not None and columns is not None  # noqa: S101 - there are holes
        square = ((columns[window] - u) ** 2 + (rows[window] - v) ** 2) / size**2
        keep = (1.0 - HOLE_SHADE * np.exp(-0.5 * square)).astype(np.float32)
        if keep.size:
            image[window] = cv2.multiply(image[window], cv2.merge([keep] * 3), dtype=cv2.CV_8U)
    return image


def _drawn(
    rng: np.random.Generator, gap_mm: float, tail_mm: float, standing_mm: float
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "m 2"]]:
    """Both strands as seen from above, from their holes on, about the middle between these."""
    way = rng.uniform(-np.pi, np.pi)
    aside = 0.5 * gap_mm * np.array((np.cos(way), np.sin(way)))
    tail = _wave(rng, tail_mm, way + np.pi + rng.uniform(-BEND_RAD, BEND_RAD))
    standing = _wave(rng, standing_mm, way + rng.uniform(-BEND_RAD, BEND_RAD))
    return tail - aside, standing + aside


def _place(
    camera: RectifiedStereo, surface: Surface, rng: np.random.Generator, path: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "2"]:
    """Where a path lies wholly in view, if it is small enough for that."""
    corners = np.array(((MARGIN_PX, MARGIN_PX), (camera.image_width - MARGIN_PX, camera.image_height - MARGIN_PX)))
    focal, centre = (camera.fx_px, camera.fy_px), (camera.cx_px, camera.cy_px)
    low, high = (corners - centre) / focal * float(surface.depth_mm.mean())
    low = low + np.array((camera.baseline, 0.0))
    return rng.uniform(0.0, 1.0, 2) * (high - low - np.ptp(path, axis=0)) + low - path.min(axis=0)


def _wave(rng: np.random.Generator, length_mm: float, heading: float) -> Float64[np.ndarray, "n 2"]:
    """A path from the origin whose heading turns as a wave."""
    x = np.linspace(0.0, 1.0, round(length_mm / SPACING_MM) + 1)
    swing = rng.choice((-1.0, 1.0)) * rng.uniform(0.2, 1.5) * (0.5 + length_mm / 120.0)
    turn = heading + swing * np.sin(2.0 * np.pi * rng.uniform(0.3, 1.0) * x)
    step = length_mm / (len(x) - 1)
    middle = 0.5 * (turn[1:] + turn[:-1])
    return np.vstack((np.zeros(2), np.cumsum(step * np.column_stack((np.cos(middle), np.sin(middle))), axis=0)))


def _lies_apart(tail: Float64[np.ndarray, "n 2"], standing: Float64[np.ndarray, "m 2"]) -> bool:
    """Whether strands keep their distance from themselves and from each other."""
    path = np.concatenate((tail[::-1], standing))
    i, j = np.triu_indices(len(path), round(NEIGHBOURS_MM / SPACING_MM))
    return bool((np.linalg.norm(path[i] - path[j], axis=1) > APART_MM).all())


def _on(surface: Surface, path: Float64[np.ndarray, "n 2"], radius_mm: float) -> Float64[np.ndarray, "n 3"]:
    """The path laid on the surface, its first point in it."""
    z = depth_at_points(surface, path) - radius_mm
    z[0] += radius_mm
    return np.column_stack((path, z))


def _is_inside(camera: RectifiedStereo, points: Float64[np.ndarray, "n 3"]) -> bool:
    last = np.array([camera.image_width, camera.image_height]) - 1.0 - MARGIN_PX
    return all(bool(((pixels > MARGIN_PX) & (pixels < last)).all()) for pixels in project(camera, points))
