"""What is no thread and looks like it, or hides it: glints, vessels, tool edges, smoke. Laid over a view at random.

Glints and vessels are laid beneath the thread, since they belong to the tissue; tools lie over it and take it away.
"""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

Image = UInt8[np.ndarray, "h w 3"]
Coverage = UInt8[np.ndarray, "h w"]
SHIFT = 4
"""Of OpenCV's drawing: sixteenths of a pixel."""


def with_glints(image: Image, coverage: Coverage, rng: np.random.Generator) -> Image:
    """Short bright streaks and specks in a common direction, such as light makes on wet tissue."""
    layer = np.zeros(coverage.shape, np.uint8)
    turn = rng.uniform(0, np.pi)
    for _ in range(int(rng.integers(3, 30))):
        start = rng.uniform(0, 1, 2) * coverage.shape[::-1]
        length, bend = rng.gamma(1.5, 6.0), rng.normal(0, 0.03)
        heading = turn + rng.normal(0, 0.5) + bend * np.linspace(0, length, 8)
        line = start + np.cumsum(np.column_stack((np.cos(heading), np.sin(heading))) * (length / 8), axis=0)
        _draw(layer, line, int(rng.integers(1, 5)), int(rng.integers(150, 256)))
    alpha = _beneath(cv2.GaussianBlur(layer, (0, 0), float(rng.uniform(0.5, 1.2))), coverage)
    return _blended(image, np.array([250.0, 252.0, 255.0], np.float32) * rng.uniform(0.85, 1.0), alpha)


def with_vessels(image: Image, coverage: Coverage, rng: np.random.Generator) -> Image:
    """Branching lines that stain the tissue, which stays visible in them: vessels, fibres, and ink on cloth."""
    stain = np.zeros(coverage.shape, np.float32)
    for _ in range(int(rng.integers(1, 5))):
        layer = np.zeros(coverage.shape, np.uint8)
        width = rng.uniform(1.0, 5.0)
        for _ in range(int(rng.integers(1, 4))):
            _draw(layer, _wander(coverage.shape, rng), max(1, round(width)), 255)
            width *= 0.7
        soft = cv2.GaussianBlur(layer, (0, 0), float(rng.uniform(0.6, 2.5)))
        stain = np.maximum(stain, soft.astype(np.float32) * rng.uniform(0.25, 0.85))
    alpha = _beneath(stain, coverage)[..., None]
    # a stain takes light away, most from blue and green; a pale fibre adds some
    keep = rng.uniform([0.2, 0.15, 0.4], [0.8, 0.7, 0.95]) if rng.uniform() < 0.75 else rng.uniform(1.1, 1.5, 3)
    return np.clip(image * (1 + alpha * (keep.astype(np.float32) - 1)), 0, 255).astype(np.uint8)


def with_tools(image: Image, coverage: Coverage, rng: np.random.Generator) -> tuple[Image, Coverage]:
    """Shaded rods, cones and jaws, over everything or beneath the thread; what they cover is thread no longer."""
    for _ in range(int(rng.choice((1, 1, 2, 3)))):
        tip, turn, radius = rng.uniform(0, 1, 2) * coverage.shape[::-1], rng.uniform(0, 2 * np.pi), rng.uniform(4, 45)
        steel = rng.uniform(20, 200) * rng.normal(1, 0.05, 3)
        parts = [(tip, turn, radius, rng.uniform(0, 0.15) if rng.uniform() < 0.3 else 0.0)]
        if rng.uniform() < 0.35:
            # two jaws open from the rod's end
            spread = rng.uniform(0.05, 0.5)
            parts += [
                (tip + 3.0 * radius * _towards(turn + np.pi + sign * spread), turn + sign * spread, radius / 2.5, 0.1)
                for sign in (-1, 1)
            ]
        is_over = rng.uniform() < 0.5
        for part in parts:
            image, coverage = _with_rod(image, coverage, part, steel, is_over, rng)
    return image, coverage


def _with_rod(
    image: Image,
    coverage: Coverage,
    rod: tuple[np.ndarray, float, float, float],
    steel: np.ndarray,
    is_over: bool,
    rng: np.random.Generator,
) -> tuple[Image, Coverage]:
    """One rod: its tip, the way it goes from there, its radius there, and how much that grows on the way."""
    tip, turn, radius, taper = rod
    y, x = np.mgrid[: coverage.shape[0], : coverage.shape[1]].astype(np.float32)
    along = (x - tip[0]) * np.cos(turn) + (y - tip[1]) * np.sin(turn)
    wide = (radius + taper * np.maximum(along, 0)).astype(np.float32)
    across = ((x - tip[0]) * np.sin(turn) - (y - tip[1]) * np.cos(turn)) / wide
    # a round end, as steep as the drawing of lots says
    away = np.hypot(across, np.minimum(along, 0) / (wide * rng.uniform(0.05, 1.5)))
    alpha = np.clip((1 - away) * wide + 0.5, 0, 1).astype(np.float32)
    light = rng.uniform(0.1, 0.7) + rng.uniform(0.3, 1.0) * np.sqrt(np.clip(1 - away**2, 0, 1))
    light += rng.uniform(0, 0.8) * np.exp(-0.5 * ((across - rng.uniform(-0.6, 0.6)) / rng.uniform(0.03, 0.4)) ** 2)
    metal = np.clip(light[..., None] * steel, 0, 255).astype(np.float32)
    shadow = cv2.GaussianBlur(alpha, (0, 0), float(rng.uniform(2, 10))) * rng.uniform(0, 0.6)
    if not is_over:
        bare = 1 - coverage.astype(np.float32) / 255
        alpha, shadow = alpha * bare, shadow * bare
    image = np.clip(image * (1 - shadow[..., None]), 0, 255)
    mixed = image + alpha[..., None] * (metal - image)
    left = coverage if not is_over else np.rint(coverage * (1 - alpha)).astype(np.uint8)
    return np.clip(mixed, 0, 255).astype(np.uint8), left


def _towards(turn: float) -> np.ndarray:
    return np.array([np.cos(turn), np.sin(turn)])


def with_smoke(image: Image, rng: np.random.Generator) -> Image:
    """A veil of cloudy grey light."""
    size = int(rng.integers(2, 6))
    cloud = cv2.resize(
        rng.uniform(0, 1, (size, size)).astype(np.float32), image.shape[1::-1], interpolation=cv2.INTER_CUBIC
    )
    alpha = np.clip(cloud * rng.uniform(0.1, 0.6), 0, 0.65)
    return _blended(image, np.full(3, rng.uniform(140, 230), np.float32), alpha)


def _beneath(layer: np.ndarray, coverage: Coverage) -> Float32[np.ndarray, "h w"]:
    """The opacity that is left of a layer, 0 to 255, where thread lies over it."""
    around = cv2.GaussianBlur(coverage, (0, 0), 1.0)
    return layer.astype(np.float32) * (1 - np.clip(around.astype(np.float32) / 128, 0, 1)) / 255


def _blended(image: Image, colour: np.ndarray, alpha: Float32[np.ndarray, "h w"]) -> Image:
    mixed = image + alpha[..., None] * (colour.astype(np.float32) - image)
    return np.clip(mixed, 0, 255).astype(np.uint8)


def _wander(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """A curve that changes its direction slowly, from somewhere in the view."""
    steps = int(rng.integers(20, 120))
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(np.cumsum(rng.normal(0, 0.02, steps)) + rng.normal(0, 0.1, steps))
    return rng.uniform(0, 1, 2) * shape[1::-1] + np.cumsum(
        3 * np.column_stack((np.cos(heading), np.sin(heading))), axis=0
    )


def _draw(layer: np.ndarray, line: np.ndarray, width: int, value: int) -> None:
    points = np.rint(line * (1 << SHIFT)).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(layer, [points], False, value, width, cv2.LINE_AA, SHIFT)
