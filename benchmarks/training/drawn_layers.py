"""Lines that are no thread, drawn once as coverage: vessels, glints, and streaks and drops of blood.

Each training lays parts of them over its crops, in other colours and the other way round each time.
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float64, UInt8

SIDE_PX, COUNT = 384, 250
"""Of a layer, and how many there are of each kind."""
SHIFT = 4
"""Of OpenCV's drawing: sixteenths of a pixel."""
Layer = UInt8[np.ndarray, "s s"]


@dataclass(frozen=True)
class Layers:
    """Coverage (n, 1, s, s), 0 to 255, of each kind."""

    vessels: torch.Tensor
    glints: torch.Tensor
    blood: torch.Tensor


def drawn_layers(seed: int, device: torch.device, count: int = COUNT) -> Layers:
    """So many layers of each kind."""
    rng = np.random.default_rng([seed, 23])

    def many(one: Callable[[np.random.Generator], Layer]) -> torch.Tensor:
        return torch.from_numpy(np.stack([one(rng) for _ in range(count)]))[:, None].to(device)

    return Layers(many(vessels), many(glints), many(blood))


def glints(rng: np.random.Generator) -> Layer:
    """Short bright streaks and specks in a common direction, such as light makes on wet tissue."""
    layer = np.zeros((SIDE_PX, SIDE_PX), np.uint8)
    turn = rng.uniform(0, np.pi)
    for _ in range(int(rng.integers(6, 70))):
        length, bend = rng.gamma(1.5, 6.0), rng.normal(0, 0.03)
        heading = turn + rng.normal(0, 0.5) + bend * np.linspace(0, length, 8)
        _draw(layer, _path(rng, heading, length / 8), int(rng.integers(1, 5)), int(rng.integers(150, 256)))
    return _soft(layer, rng.uniform(0.5, 1.2))


def vessels(rng: np.random.Generator) -> Layer:
    """Branching lines: vessels, fibres, and ink on cloth; some in pieces, as they show between glints and fat."""
    stain = np.zeros((SIDE_PX, SIDE_PX), np.uint8)
    for _ in range(int(rng.integers(1, 7))):
        layer = np.zeros_like(stain)
        width = rng.uniform(1.0, 6.0)
        for _ in range(int(rng.integers(1, 4))):
            _draw(layer, _wander(rng), max(1, round(width)), 255)
            width *= 0.7
        soft = _soft(layer, rng.uniform(0.6, 2.5)).astype(np.float32) * rng.uniform(0.3, 1.0)
        stain = np.maximum(stain, (soft * (_patches(rng) if rng.uniform() < 0.5 else 1.0)).astype(np.uint8))
    return stain


def blood(rng: np.random.Generator) -> Layer:
    """Streaks whose width changes along them, and drops: thread has one width."""
    layer = np.zeros((SIDE_PX, SIDE_PX), np.uint8)
    for _ in range(int(rng.integers(1, 5))):
        line = _wander(rng)
        along = np.linspace(0, 1, len(line))
        taper = np.clip(along / rng.uniform(0.1, 1.0), 0.12, 1)
        radius = rng.uniform(0.8, 5.0) * np.exp(_smooth(rng, len(line))) * taper
        kept = _smooth(rng, len(line)) > rng.uniform(-1.5, 0.2)
        for (x, y), size, shown in zip(line, radius, kept, strict=True):
            if shown:
                cv2.circle(layer, (round(16 * x), round(16 * y)), max(8, round(16 * size)), 255, -1, cv2.LINE_AA, SHIFT)
    for _ in range(int(rng.integers(0, 8))):
        middle, axes = rng.uniform(0, SIDE_PX, 2), rng.gamma(1.5, 5.0) * rng.uniform(0.4, 1.0, 2) + 1
        shape = (tuple(middle.tolist()), tuple((2 * axes).tolist()), float(rng.uniform(0, 180)))
        cv2.ellipse(layer, shape, 255, -1, cv2.LINE_AA)
    return _soft(layer, rng.uniform(0.5, 1.3))


def _smooth(rng: np.random.Generator, count: int) -> Float64[np.ndarray, "n"]:
    """Values of deviation about 0.8 that change slowly from one to the next."""
    knots = max(2, count // int(rng.integers(3, 12)))
    return np.interp(np.arange(count), np.linspace(0, count - 1, knots), rng.normal(0, 0.8, knots))


def _patches(rng: np.random.Generator) -> np.ndarray:
    """A field of 0 and 1 with soft edges, half of each."""
    cells = int(rng.integers(6, 24))
    field = cv2.resize(rng.normal(0, 1, (cells, cells)), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_CUBIC)
    return np.clip(2 * np.asarray(field) + 0.5, 0, 1)


def _wander(rng: np.random.Generator) -> Float64[np.ndarray, "n 2"]:
    """A curve that changes its direction slowly."""
    steps = int(rng.integers(12, 120))
    turns = np.cumsum(rng.normal(0, 0.02, steps)) + rng.normal(0, 0.1, steps)
    return _path(rng, rng.uniform(0, 2 * np.pi) + np.cumsum(turns), 3.0)


def _path(rng: np.random.Generator, heading: np.ndarray, step_px: float) -> Float64[np.ndarray, "n 2"]:
    steps = step_px * np.column_stack((np.cos(heading), np.sin(heading)))
    return rng.uniform(0, SIDE_PX, 2) + np.cumsum(steps, axis=0)


def _soft(layer: Layer, sigma_px: float) -> Layer:
    return np.asarray(cv2.GaussianBlur(layer, (0, 0), float(sigma_px)), np.uint8)


def _draw(layer: Layer, line: np.ndarray, width: int, value: int) -> None:
    points = np.rint(line * (1 << SHIFT)).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(layer, [points], False, value, width, cv2.LINE_AA, SHIFT)
