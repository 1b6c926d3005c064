"""The first correction of a tool, by a search over six numbers.

Of corrections drawn from what is known beforehand, the best are kept and others drawn around them, again and again (the
cross-entropy method: Rubinstein, 1999), in both eyes at once. What counts is here how much pixels look like an
instrument: points within it should, and points beside and beyond it should not. Several starts guard against a wrong
one.

**Long edges** count whatever colour is on either side. Shaft and wrist are long and straight, and their edges are seen
where colour does not tell steel from tissue. With g the slope of colour and n the normal of an expected edge, what
counts is the mean of

    (n·g)² / (|g|² + STEEP²)

over both edges and both eyes: 1 where all steep slopes stand across the edge, a half or less in texture.

**The order** of all this: colours are learnt where the tool probably is, it is searched for with them, colours are
learnt anew around what was found, it is searched for there, and edges refine it. Where tissue is as grey as steel the
first colours lead astray, so some searches begin with long edges in their stead. Random numbers are those of a
generator that is handed in, so that the same images give the same correction.
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from agents.tool_tracker.correction import Correction, about
from agents.tool_tracker.evidence import SHRINK, Table, eye, learnt, likeness, softened
from agents.tool_tracker.outline import silhouette
from agents.tool_tracker.refinement import Refined, View, refined
from agents.tool_tracker.tubes import FINGER, SHAFT, Tube
from schemas.messages import RectifiedStereo

DRAWN, KEPT, ROUNDS = 320, 0.1, 6
SILHOUETTES = 24
INSIDE, OUTSIDE = (0.0, -0.45, 0.45, -0.8, 0.8), (-1.3, 1.3, -1.9, 1.9, -3.0, 3.0)
SMOOTHED = 0.6
"""Of the new spread in each round; the rest is of the one before."""


Scores = Callable[[Float64[np.ndarray, "m 6"]], Float64[np.ndarray, "m"]]
"""How well each of some twists fits the images."""


@dataclass(frozen=True, eq=False)
class _Probe:
    """Points that move with the tool, what each counts for, and that they add up to 1 inside and -1 outside."""

    points: Float64[np.ndarray, "n 3"]
    weight: Float64[np.ndarray, "n"]


def likely(
    camera: RectifiedStereo,
    maps: tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]],
    parts: tuple[Tube, ...],
    pivot: Float64[np.ndarray, "3"],
) -> Scores:
    """By how much pixels look like an instrument: 1 where all inside does and nothing outside.

    Args:
        parts: where the tool is without any twist.
    """
    small = tuple(_shrunk(one) for one in maps)
    probe = _probe(parts)
    return lambda twists: _scores(camera, small, probe, twists, pivot)


def searched(
    scores: Scores,
    deviation: Float64[np.ndarray, "6"],
    rng: np.random.Generator,
    begun: Float64[np.ndarray, "6"],
    held: float,
) -> Float64[np.ndarray, "6"]:
    """The twist that fits best, of those that deviate so much from where it is begun.

    Args:
        held: what a twist loses for the square of each of its deviations.
    """
    mean, spread = begun, deviation.copy()
    best, best_score = mean, -np.inf
    for _ in range(ROUNDS):
        twists = mean + spread * rng.standard_normal((DRAWN, 6))
        found = scores(twists) - held * (((twists - begun) / deviation) ** 2).sum(axis=1)
        order = np.argsort(-found)[: round(KEPT * DRAWN)]
        if found[order[0]] > best_score:
            best, best_score = twists[order[0]], float(found[order[0]])
        mean = twists[order].mean(axis=0)
        spread = SMOOTHED * twists[order].std(axis=0) + (1 - SMOOTHED) * spread
    both = np.stack((mean, best))
    return both[int(np.argmax(scores(both)))]


def probably_within(
    camera: RectifiedStereo,
    parts: tuple[Tube, ...],
    deviation: Float64[np.ndarray, "6"],
    pivot: Float64[np.ndarray, "3"],
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "k l"], Float32[np.ndarray, "k l"]]:
    """How probably each pixel of both eyes, at 1 / SHRINK of the size, is within the instrument."""
    size = (camera.image_height // SHRINK, camera.image_width // SHRINK)
    sums = (np.zeros(size, np.float32), np.zeros(size, np.float32))
    for T in about(pivot, deviation * rng.standard_normal((SILHOUETTES, 6))):
        moved = tuple(part.moved(T) for part in parts)
        for i, eye_x in enumerate((0.0, camera.baseline)):
            sums[i][...] += silhouette(camera, moved, eye_x, size)
    return sums[0] / SILHOUETTES, sums[1] / SILHOUETTES


def _probe(parts: tuple[Tube, ...]) -> _Probe:
    points, weights = [], []
    for part in parts:
        d = np.gradient(part.places, axis=0)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        b = np.cross(d, part.places)
        b /= np.linalg.norm(b, axis=1, keepdims=True)
        size = np.maximum(part.wide, part.thick)[:, None]
        counts = 1.0 if part.part == SHAFT else 1.5
        step = 3
        for share in INSIDE if part.part != FINGER else (0.0,):
            points.append((part.places + share * size * b)[::step])
            weights.append(np.full(len(points[-1]), counts / len(INSIDE)))
        if part.part == FINGER:
            beyond = part.places[-1] + np.array((0.0025, 0.005, 0.009))[:, None] * d[-1]
            points.append(beyond)
            weights.append(np.full(3, -1.0))
            continue
        for share in OUTSIDE:
            points.append((part.places + share * size * b)[::step])
            weights.append(np.full(len(points[-1]), -counts / len(OUTSIDE)))
    return _Probe(np.concatenate(points), np.concatenate(weights))


def _scores(
    camera: RectifiedStereo,
    maps: tuple[np.ndarray, ...],
    probe: _Probe,
    twists: Float64[np.ndarray, "m 6"],
    pivot: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, "m"]:
    """Mean likeness inside less mean likeness outside, over what is in view of either eye."""
    T = about(pivot, twists)
    x, y, z = np.moveaxis(np.einsum("mij,nj->mni", T[:, :3, :3], probe.points) + T[:, None, :3, 3], -1, 0)
    z = np.maximum(z, 1e-3)
    v = ((camera.fy_px * y / z + camera.cy_px) / SHRINK).astype(np.int64)
    inside, outside = probe.weight > 0, probe.weight < 0
    total = np.zeros(len(twists))
    for like, eye_x in zip(maps, (0.0, camera.baseline), strict=True):
        u = ((camera.fx_px * (x - eye_x) / z + camera.cx_px) / SHRINK).astype(np.int64)
        seen = (u >= 0) & (v >= 0) & (u < like.shape[1]) & (v < like.shape[0])
        value = like[np.clip(v, 0, like.shape[0] - 1), np.clip(u, 0, like.shape[1] - 1)]
        weight = np.abs(probe.weight) * seen
        share = weight[:, inside].sum(axis=1) / probe.weight[inside].sum()
        within = (value * weight)[:, inside].sum(axis=1) / np.maximum(weight[:, inside].sum(axis=1), 1e-9)
        around = (value * weight)[:, outside].sum(axis=1) / np.maximum(weight[:, outside].sum(axis=1), 1e-9)
        # what is hardly in view says little
        total += 0.5 * (within - around) * np.minimum(share / 0.25, 1.0)
    return total


def _shrunk(one: Float32[np.ndarray, "h w"]) -> np.ndarray:
    size = (one.shape[1] // SHRINK, one.shape[0] // SHRINK)
    return cv2.GaussianBlur(cv2.resize(one, size, interpolation=cv2.INTER_AREA), (0, 0), 1.0)


STEEP = 8.0
"""Grey levels a small pixel."""
LEAST = 12
"""Fewer points in view than this count as if there were more, without an edge."""
STEP = 2

Slopes = tuple[Float32[np.ndarray, "k l"], Float32[np.ndarray, "k l"], Float32[np.ndarray, "k l"]]


def lined(
    camera: RectifiedStereo,
    soft: tuple[UInt8[np.ndarray, "h w 3"], ...],
    parts: tuple[Tube, ...],
    pivot: Float64[np.ndarray, "3"],
) -> Scores:
    """The module's mean for twists; `parts` is where the tool is without any."""
    slopes = [_slopes(one) for one in soft]
    points, along = _edges(parts)
    eyes = (0.0, camera.baseline)

    def scores(twists: Float64[np.ndarray, "m 6"]) -> Float64[np.ndarray, "m"]:
        T = about(pivot, twists)
        p = np.einsum("mij,nj->mni", T[:, :3, :3], points) + T[:, None, :3, 3]
        d = np.einsum("mij,nj->mni", T[:, :3, :3], along)
        return sum(
            (0.5 * _steep(camera, one, p, d, eye_x) for one, eye_x in zip(slopes, eyes, strict=True)),
            np.zeros(len(twists)),
        )

    return scores


def _slopes(soft: UInt8[np.ndarray, "h w 3"]) -> Slopes:
    """Products of the slopes of colour along x and y (xx, yy, xy) at 1 / SHRINK of the size, of slopes at most 1."""
    size = (soft.shape[1] // SHRINK, soft.shape[0] // SHRINK)
    small = cv2.GaussianBlur(cv2.resize(soft, size, interpolation=cv2.INTER_AREA).astype(np.float32), (0, 0), 1.0)
    x, y = (cv2.Sobel(small, cv2.CV_32F, *order) / 8 for order in ((1, 0), (0, 1)))
    products = [(one * other).sum(axis=2) for one, other in ((x, x), (y, y), (x, y))]
    share = 1 / (products[0] + products[1] + STEEP**2)
    xx, yy, xy = (cv2.GaussianBlur(one * share, (0, 0), 1.0) for one in products)
    return xx, yy, xy


def _edges(parts: tuple[Tube, ...]) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Points of both edges of shaft and wrist, and the way along them."""
    points, along = [], []
    for part in (one for one in parts if one.part != FINGER):
        d = np.gradient(part.places, axis=0)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        b = np.cross(d, part.places)
        b *= np.maximum(part.wide, part.thick)[:, None] / np.linalg.norm(b, axis=1, keepdims=True)
        points += [(part.places + side * b)[::STEP] for side in (-1, 1)]
        along += [d[::STEP]] * 2
    return np.concatenate(points), np.concatenate(along)


def _steep(
    camera: RectifiedStereo,
    slopes: Slopes,
    points: Float64[np.ndarray, "m n 3"],
    along: Float64[np.ndarray, "m n 3"],
    eye_x: float,
) -> Float64[np.ndarray, "m"]:
    """The mean over what is in view of one eye."""
    z = np.maximum(points[..., 2], 1e-3)
    x, y = (points[..., 0] - eye_x) / z, points[..., 1] / z
    u, v = along[..., 0] - x * along[..., 2], along[..., 1] - y * along[..., 2]
    long = np.maximum(np.hypot(u, v), 1e-9)
    column = ((camera.fx_px * x + camera.cx_px) / SHRINK).astype(np.int64)
    row = ((camera.fy_px * y + camera.cy_px) / SHRINK).astype(np.int64)
    height, width = slopes[0].shape
    seen = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    at = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    xx, yy, xy = (one[at] for one in slopes)
    across = (v * v * xx + u * u * yy - 2 * u * v * xy) / long**2
    return (across * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), LEAST)


NARROWER = 0.4
"""The second search's spread over the first's."""
FOUND_M, FOUND_RAD = 0.004, 0.04
"""How far (one deviation) what was searched for may be off."""
REACH_PX = 25.0
HELD, LINES_HELD = 0.01, 0.003
"""What the square of a deviation costs, in shares of what fits."""

Soft = tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]


def soft_pair(left: UInt8[np.ndarray, "h w 3"], right: UInt8[np.ndarray, "h w 3"]) -> Soft:
    """Both images, blue first and rectified, with less noise."""
    return softened(left), softened(right)


class Begin(enum.Enum):
    """With what a search begins: that instruments are grey, with long edges, or with neither."""

    GREY = 0
    LINES = 1
    PLACE = 2


def acquired(
    soft: Soft, view: View, before: Correction, rng: np.random.Generator, begin: Begin
) -> tuple[Refined, Table]:
    """The correction that these images speak for, and the colours of the tool; `view.eyes` is not looked at."""
    camera, pivot, deviation = view.camera, before.pivot, np.sqrt(np.diag(before.covariance))
    parts, twist = view.parts(np.eye(4)), before.twist
    if begin is Begin.LINES:
        twist = searched(lined(camera, soft, parts, pivot), deviation, rng, twist, LINES_HELD)
    table = np.zeros((16, 16, 16), np.float32)
    for share in (NARROWER,) if begin is Begin.LINES else (1.0, NARROWER):
        moved = tuple(part.moved(about(pivot, twist)) for part in parts)
        within = probably_within(camera, moved, share * deviation, pivot, rng)
        table = learnt(soft, within, begin is Begin.GREY)
        maps = (likeness(soft[0], table), likeness(soft[1], table))
        twist = searched(likely(camera, maps, parts, pivot), share * deviation, rng, twist, HELD)
    found = Correction(twist, np.diag(np.repeat((FOUND_M, FOUND_RAD), 3) ** 2), pivot)
    return refined(looking(view, soft, table), found, first_reach_px=REACH_PX), table


def looking(view: View, soft: Soft, table: Table) -> View:
    """A view with its images made ready."""
    eyes = (eye(soft[0], table), eye(soft[1], table))
    return View(view.camera, eyes, view.T_camera_base, view.T_base_tool, view.jaw_rad)


def prior(pivot: Float64[np.ndarray, "3"], metres: float, radians: float) -> Correction:
    """What is known before anything was seen: deviations of each axis."""
    return Correction(np.zeros(6), np.diag(np.repeat((metres, radians), 3) ** 2), pivot)
