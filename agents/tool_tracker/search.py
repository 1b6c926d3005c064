"""The first correction of a tool, by a search over six numbers.

Of corrections drawn from what is known beforehand, the best are kept and others drawn around them, again and again (the
cross-entropy method: Rubinstein, 1999), in both eyes at once. What counts is here how much pixels look like an
instrument: points within it should, and points beside and beyond it should not. Several starts guard against a wrong
one; lines.py begins with something else.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from agents.tool_tracker.correction import about
from agents.tool_tracker.evidence import SHRINK
from agents.tool_tracker.outline import silhouette
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
