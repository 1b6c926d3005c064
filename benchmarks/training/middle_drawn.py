"""Profiles that are drawn, not rendered: threads in light from any side, with shadows beside them, of any width.

Rendered lamps stand beside the lens, as those of endoscopes do. These profiles teach that where colours meet is the
edge, whatever light does on either side of it.
"""

import cv2
import numpy as np
from jaxtyping import Float64

from agents.perception.centrelines.along import Pieces
from agents.perception.centrelines.learned import BEYOND_PX
from benchmarks.training.middle_views import WIDE_PLACES, MiddleView

POINTS, KNOT_POINTS = 400, 40
WIDTH_PX = 1.3, 10.0
BLUR_PX = 0.35, 1.4
FINE = 8
"""Places between two of WIDE_PLACES, so that thin threads and sharp edges are drawn as they are."""
LEAST_CONTRAST = 25.0
MOST_LOPSIDED, MOST_LIMB = 0.7, 0.5
MOST_SHADOW, SHADOW_WIDTHS = 0.55, (0.1, 1.6)
FARTHEST_ROUGH_PX = 0.3


def drawn_view(rng: np.random.Generator) -> MiddleView:
    """One thread, wound at random, in one light; the rough middle lies aside by what varies slowly."""
    width = np.exp(rng.uniform(*np.log(WIDTH_PX))) * (1 + 0.1 * _slow(rng))
    angle = rng.uniform(0, 2 * np.pi) + rng.uniform(0.2, 2.5) * _slow(rng)
    normal = np.column_stack((np.cos(angle), np.sin(angle)))
    towards = rng.uniform(0, 2 * np.pi)
    # the share of the light's direction across the thread, from -1 to 1
    across = normal @ np.array([np.cos(towards), np.sin(towards)])
    rough = rng.uniform(0, FARTHEST_ROUGH_PX) * _slow(rng)
    reach = width + BEYOND_PX
    places = np.linspace(WIDE_PLACES[0], WIDE_PLACES[-1], FINE * (len(WIDE_PLACES) - 1) + 1)
    off = reach[:, None] * places + rough[:, None]
    colour = _blurred(_light(off, width, across, rng), reach, places, rng.uniform(*BLUR_PX))[:, ::FINE]
    noise = rng.uniform(0, 5)
    colour = np.clip(colour + rng.normal(0, noise, colour.shape), 0, 255)
    return MiddleView(
        "drawn",
        Pieces(np.zeros(POINTS, np.int64)),
        normal,
        width,
        colour.astype(np.uint8),
        (-rough).astype(np.float32),
        np.ones(POINTS, bool),
        np.full(POINTS, np.nan, np.float32),
    )


def _light(
    off: Float64[np.ndarray, "n t"],
    width: Float64[np.ndarray, "n"],
    across: Float64[np.ndarray, "n"],
    rng: np.random.Generator,
) -> Float64[np.ndarray, "n t 3"]:
    """Thread and ground, before any lens; `off` is in pixels from the true middle."""
    ground, thread = _colours(rng)
    x = off / (width[:, None] / 2)
    limb = np.maximum(1 - np.clip(x, -1, 1) ** 2, 0.02) ** rng.uniform(0, MOST_LIMB)
    lopsided = 1 + rng.uniform(0, MOST_LOPSIDED) * rng.choice((-1, -1, -1, 1)) * across[:, None] * np.clip(x, -1, 1)
    gloss = rng.choice((0.0, 1.0)) * rng.uniform(20, 120) * np.exp(-0.5 * ((x - 0.5 * across[:, None]) / 0.25) ** 2)
    on_thread = thread * (limb * lopsided)[..., None] + gloss[..., None]
    shadow = 1 - rng.uniform(0, MOST_SHADOW) * _band(x, across, rng) - rng.uniform(0, 0.3) * _band(x, -across, rng)
    sides = 1 + 0.1 * rng.normal() * np.sign(x) + 0.1 * _slow(rng)[:, None]
    on_ground = ground * (shadow * sides)[..., None]
    return np.where((np.abs(x) < 1)[..., None], on_thread, on_ground)


def _band(
    x: Float64[np.ndarray, "n t"], across: Float64[np.ndarray, "n"], rng: np.random.Generator
) -> Float64[np.ndarray, "n t"]:
    """Where the thread's shadow lies on the ground, from 0 to 1: as wide as the thread, cast aside by its height."""
    aside = across * np.exp(rng.uniform(*np.log(SHADOW_WIDTHS))) * (1 + 0.5 * _slow(rng))
    return shadow_band(x, aside, rng.uniform(0.05, 0.4))


def shadow_band(
    x: Float64[np.ndarray, "*n t"], aside: Float64[np.ndarray, "*n"], soft: float
) -> Float64[np.ndarray, "*n t"]:
    """A band as wide as the thread, so many of its widths aside, from 0 to 1; in half widths from the true middle."""
    return 1 / (1 + np.exp(np.clip((np.abs(x - 2 * aside[..., None]) - 1) / soft, -50, 50)))


def _colours(rng: np.random.Generator) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Of the ground and of the thread, blue first: reddish, and any colour that can be told from it."""
    while True:
        red = rng.uniform(90, 220)
        ground = np.array([red * rng.uniform(0.4, 1.0), red * rng.uniform(0.4, 1.0), red])
        thread = rng.uniform(10, 230) * np.exp(rng.normal(0, 0.35, 3))
        if np.sqrt(np.mean((np.clip(thread, 0, 255) - ground) ** 2)) > LEAST_CONTRAST:
            return ground, np.clip(thread, 0, 255)


def _blurred(
    light: Float64[np.ndarray, "n t 3"], reach: Float64[np.ndarray, "n"], places: Float64[np.ndarray, "t"], blur: float
) -> Float64[np.ndarray, "n t 3"]:
    """A lens's blur across the thread; along it hardly anything changes."""
    sigma = max(blur / (float(np.mean(reach)) * float(places[1] - places[0])), 1e-3)
    x = np.arange(-np.ceil(3 * sigma), np.ceil(3 * sigma) + 1)
    kernel = np.exp(-0.5 * (x / sigma) ** 2)
    flat = light.transpose(0, 2, 1).reshape(-1, light.shape[1]).astype(np.float32)
    seen = cv2.sepFilter2D(flat, cv2.CV_32F, kernel / kernel.sum(), np.ones(1), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.float64).reshape(len(light), 3, -1).transpose(0, 2, 1)


def _slow(rng: np.random.Generator) -> Float64[np.ndarray, "n"]:
    """What varies slowly along the thread, about as much as a standard normal."""
    knots = rng.normal(size=POINTS // KNOT_POINTS + 2)
    return np.interp(np.arange(POINTS) / KNOT_POINTS, np.arange(len(knots)), knots)
