"""Plausible threads on a surface, drawn as the left image shows them and laid onto the surface along its rays.

A path is a heading as a function of length, integrated in the image plane (in millimetres at the working distance),
with a climb towards the camera: `climb` is the slope angle against the image plane, 90° where the thread runs along
the line of sight. Paths are drawn again until they meet what their configuration promises.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo
from shared.arc_length import even_parameters
from shared.camera import project
from shared.rendering.centreline import Thread
from shared.rendering.surface import Surface, depth_at_points, meet_rays
from shared.splines import basis_matrix, clamped_uniform_knots, evaluate

MARGIN_PX = 24.0
FLAT_DEG = 6.0
ALONG_SIGHT_MM = 15.0
CLEARANCE_MM = 0.1
ATTEMPTS = 200
SAMPLES = 600
DEGREE = 3


class ShapeError(ValueError):
    """No thread of that configuration: the text names what is wrong and what would do."""


@dataclass(frozen=True)
class Path:
    """A curve in the image plane, in mm from its own middle, with its height towards the camera above the surface."""

    xy_mm: Float64[np.ndarray, "n 2"]
    lift_mm: Float64[np.ndarray, "n"]
    control_spacing_mm: float


def thread_on(
    camera: RectifiedStereo, surface: Surface, config: str, seed: int, radius_mm: float | None = None
) -> Thread:
    """A thread of a configuration (see CONFIGS), inside both images with a margin; radius 0.15 to 0.25 mm if not given.

    Raises:
        ShapeError: where there is no such configuration, or the camera sees too little for it.
    """
    if config not in CONFIGS:
        raise ShapeError(f"unknown configuration {config!r}; known configurations: {', '.join(CONFIGS)}")
    rng = np.random.default_rng([seed, 4, list(CONFIGS).index(config)])
    radius = float(rng.uniform(0.15, 0.25)) if radius_mm is None else radius_mm
    draw, promise = CONFIGS[config]
    for _ in range(ATTEMPTS):
        thread = _laid_on(camera, surface, draw(rng), radius, rng)
        if _is_inside(camera, thread) and promise(camera, thread):
            return thread
    raise ShapeError(
        f"found no {config} thread that fits into both images at this distance; use a wider or more distant view"
    )


def flat_share(camera: RectifiedStereo, thread: Thread) -> float:
    """Share of the length whose left projection runs within six degrees of the image rows."""
    pixels, _ = project(camera, _even_points(thread))
    du, dv = np.abs(np.diff(pixels, axis=0)).T
    return float((np.arctan2(dv, du) < np.radians(FLAT_DEG)).mean())


def crossings(camera: RectifiedStereo, thread: Thread) -> int:
    """How often the thread's left projection crosses itself."""
    pixels, _ = project(camera, _even_points(thread))
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))))
    # even steps in the image, so that a stretch along the line of sight does not cross its own rounding
    even = np.linspace(0.0, travelled[-1], SAMPLES // 2)
    pixels = np.column_stack([np.interp(even, travelled, axis) for axis in pixels.T])
    a, b = pixels[:-1], pixels[1:]
    i, j = np.triu_indices(len(a), 2)
    apart = (_side(a[i], b[i], a[j]) * _side(a[i], b[i], b[j]) < 0) & (
        _side(a[j], b[j], a[i]) * _side(a[j], b[j], b[i]) < 0
    )
    return int(apart.sum())


def length_along_sight(thread: Thread, within_deg: float = 15.0) -> float:
    """Length in mm of the stretches that run within so many degrees of the line of sight."""
    points = _even_points(thread)
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    sight = points[:-1] / np.linalg.norm(points[:-1], axis=1, keepdims=True)
    along = np.abs((step * sight).sum(axis=1)) / length
    return float(length[along > np.cos(np.radians(within_deg))].sum())


def _easy(rng: np.random.Generator) -> Path:
    length = rng.uniform(45.0, 65.0)
    base = rng.choice((-1.0, 1.0)) * rng.uniform(0.7, 1.2)
    return _path(rng, length, lambda x: base + _wave(rng, x, rng.uniform(0.4, 0.65), rng.uniform(0.7, 1.1)))


def _medium(rng: np.random.Generator) -> Path:
    length = rng.uniform(95.0, 125.0)
    side = rng.choice((-1.0, 1.0))
    base = rng.uniform(-0.2, 0.2)
    amplitude, cycles = rng.uniform(1.25, 1.5), rng.uniform(1.0, 1.2)
    return _path(rng, length, lambda x: base + side * amplitude * np.cos(2.0 * np.pi * cycles * x))


def _hard(rng: np.random.Generator) -> Path:
    """A hairpin on its side: two arms along the rows, and a bend of a little more than a quarter of the length."""
    radius = rng.uniform(8.5, 11.5)
    arm = rng.uniform(3.5, 4.4) * radius
    length = 2.0 * arm + np.pi * radius
    slopes = rng.uniform(-0.07, 0.07, 2)
    facing, turning = rng.choice((0.0, np.pi)), rng.choice((-1.0, 1.0))

    def heading(x: np.ndarray) -> np.ndarray:
        bend = np.clip((x * length - arm) / (np.pi * radius), 0.0, 1.0)
        return facing + slopes[0] * (1.0 - bend) + (turning * np.pi + slopes[1]) * bend

    return _path(rng, length, heading, control_spacing_mm=3.5)


def _singularity(rng: np.random.Generator) -> Path:
    """A wave whose middle climbs towards the camera along the line of sight."""
    before, climb, after, bend = rng.uniform(24.0, 30.0), ALONG_SIGHT_MM - 2.0, rng.uniform(34.0, 42.0), 6.0
    length = before + climb + after + 2.0 * bend
    base, side = rng.uniform(-0.35, 0.35), rng.choice((-1.0, 1.0))
    places = np.cumsum([0.0, before, bend, climb, 1.6 * bend]) / length
    angles = np.radians([0.0, 0.0, 90.0, 90.0, -24.0])

    def slope(x: np.ndarray) -> np.ndarray:
        return np.interp(x, places, angles)

    return _path(
        rng,
        length,
        lambda x: base + side * 0.55 * np.cos(2.0 * np.pi * 1.1 * x),
        climb=slope,
        control_spacing_mm=2.5,
    )


def _crossing(rng: np.random.Generator) -> Path:
    """A loop whose later strand lies on the earlier one."""
    length = rng.uniform(105.0, 130.0)
    base, side, turn = rng.uniform(-np.pi, np.pi), rng.choice((-1.0, 1.0)), rng.uniform(5.6, 7.0)
    return _path(
        rng,
        length,
        lambda x: base + side * turn * _ease((x - 0.2) / 0.6) + _wave(rng, x, 0.25, 1.3),
        rise_mm=rng.uniform(2.0, 3.0),
    )


def _path(
    rng: np.random.Generator,
    length: float,
    heading: Callable[[np.ndarray], np.ndarray],
    climb: Callable[[np.ndarray], np.ndarray] = np.zeros_like,
    rise_mm: float = 0.0,
    control_spacing_mm: float = 5.5,
) -> Path:
    x = np.linspace(0.0, 1.0, SAMPLES)
    direction, slope = heading(x), climb(x)
    step = length / (SAMPLES - 1)
    speed = np.cos(slope) * step
    xy = np.cumsum(np.column_stack((speed * np.cos(direction), speed * np.sin(direction))), axis=0)
    lift = np.cumsum(np.sin(slope) * step) + rise_mm * _ease((x - 0.3) / 0.4)
    lift += rng.uniform(0.2, 0.9) * (1.0 + np.sin(2.0 * np.pi * (rng.uniform(0.8, 1.8) * x + rng.uniform())))
    return Path(xy - 0.5 * (xy.min(axis=0) + xy.max(axis=0)), np.maximum(lift, 0.0), control_spacing_mm)


def _laid_on(
    camera: RectifiedStereo, surface: Surface, path: Path, radius_mm: float, rng: np.random.Generator
) -> Thread:
    """The path placed somewhere in both images, laid on the surface, and fitted with a spline that clears it."""
    distance = float(surface.depth_mm.mean())
    half = np.abs(path.xy_mm).max(axis=0)
    low = np.array([MARGIN_PX - camera.cx_px, MARGIN_PX - camera.cy_px]) * distance / camera.fx_px + half
    low[0] += 1.15 * camera.baseline
    high = np.array([camera.image_width, camera.image_height]) - 1.0 - MARGIN_PX - (camera.cx_px, camera.cy_px)
    high = high * distance / camera.fx_px - half
    middle = low + rng.uniform(0.25, 0.75, 2) * (high - low)
    tangents = ((path.xy_mm + middle) / distance).astype(np.float32)
    depth = meet_rays(surface, tangents[:, :1], tangents[:, 1:], 0.0)[:, 0]
    z = depth - path.lift_mm - radius_mm - CLEARANCE_MM
    points = np.column_stack((tangents * z[:, None], z)).astype(np.float64)
    return _cleared(surface, fitted(points, path.control_spacing_mm, radius_mm))


def fitted(points: Float64[np.ndarray, "n 3"], spacing_mm: float, radius_mm: float) -> Thread:
    """The spline through points in order, with control points so far apart, about."""
    chords = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    knots = clamped_uniform_knots(max(round(chords[-1] / spacing_mm), 6) + DEGREE, DEGREE)
    basis = basis_matrix(knots, DEGREE, chords / chords[-1])
    control_points = np.linalg.lstsq(basis, points, rcond=None)[0]
    return Thread(knots, np.round(control_points, 5), radius_mm, DEGREE)


def _cleared(surface: Surface, thread: Thread) -> Thread:
    """The thread, raised as a whole where it would dip into the surface."""
    points = _even_points(thread)
    gap = depth_at_points(surface, points[:, :2]) - points[:, 2] - thread.radius_mm
    raised = np.round(max(0.5 * CLEARANCE_MM - float(gap.min()), 0.0), 5)
    return Thread(thread.knots, thread.control_points - (0.0, 0.0, raised), thread.radius_mm, thread.degree)


def _is_inside(camera: RectifiedStereo, thread: Thread) -> bool:
    last = np.array([camera.image_width, camera.image_height]) - 1.0 - MARGIN_PX
    return all(bool(((pixels > MARGIN_PX) & (pixels < last)).all()) for pixels in project(camera, _even_points(thread)))


def _even_points(thread: Thread) -> Float64[np.ndarray, "n 3"]:
    s = even_parameters(thread.knots, thread.control_points, thread.degree, SAMPLES)
    return evaluate(thread.knots, thread.control_points, thread.degree, s)


def _wave(rng: np.random.Generator, x: np.ndarray, amplitude: float, cycles: float) -> np.ndarray:
    return amplitude * np.sin(2.0 * np.pi * (cycles * x + rng.uniform()))


def _ease(x: np.ndarray) -> np.ndarray:
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _side(
    a: Float64[np.ndarray, "n 2"], b: Float64[np.ndarray, "n 2"], p: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "n"]:
    """Positive where p lies to the one side of the line from a to b, negative to the other."""
    return (b[:, 0] - a[:, 0]) * (p[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (p[:, 0] - a[:, 0])


def _plain_to_see(camera: RectifiedStereo, thread: Thread) -> bool:
    return crossings(camera, thread) == 0 and flat_share(camera, thread) < 0.15


def _mostly_flat(camera: RectifiedStereo, thread: Thread) -> bool:
    return crossings(camera, thread) == 0 and abs(flat_share(camera, thread) - 0.73) < 0.015


def _partly_along_sight(camera: RectifiedStereo, thread: Thread) -> bool:
    return crossings(camera, thread) == 0 and abs(length_along_sight(thread) - ALONG_SIGHT_MM) < 1.0


def _crosses_itself(camera: RectifiedStereo, thread: Thread) -> bool:
    return crossings(camera, thread) > 0


CONFIGS: dict[str, tuple[Callable[[np.random.Generator], Path], Callable[[RectifiedStereo, Thread], bool]]] = {
    "easy": (_easy, _plain_to_see),
    "medium": (_medium, _plain_to_see),
    "hard": (_hard, _mostly_flat),
    "singularity": (_singularity, _partly_along_sight),
    "crossing": (_crossing, _crosses_itself),
}
"""Each configuration: how its path is drawn, and what the finished thread must fulfil."""
