"""What speaks for a line being thread: python -m benchmarks.training.line_odds --scenes DIR --judged DIR.

Lines of scenes with known truth (`segmentation.network.lines_in`), seen as they are and through worse cameras, are told
thread from none by logistic regression. What it finds is printed, and then, of scenes that it was not fitted to, how
many lines of each probability are thread: a fit that is calibrated has as many as it says.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float64, UInt8
from scipy.optimize import minimize

from agents.perception.segmentation.classes import as_usual, thread_score
from agents.perception.segmentation.network import WEIGHTS, evidence, lines_in
from benchmarks.training.scenes import View, views_in

Image = UInt8[np.ndarray, "h w 3"]
AS_IT_IS = 0.2
"""Of the views; the others are seen through a worse camera."""
COVERED, BESIDE_PX = 60, 3
"""Coverage from which a pixel shows thread, 0 to 255, and how far beside it a line may lie."""
SHORTEST_PX, WHOLE_PX = 8, 200
"""Shorter lines are left out, and a line counts by its length, up to so much of it."""
RIDGE = 0.05
BINS = 0, 0.1, 0.3, 0.5, 0.7, 0.9, 1


@dataclass(frozen=True)
class Options:
    """What is fitted, and judged."""

    scenes: tuple[Path, ...]
    """Folders of scenes to fit to."""
    judged: tuple[Path, ...] = ()
    """Folders of other scenes."""
    seed: int = 5
    """Of the worse cameras."""


def main() -> None:
    """Fit and judge."""
    options = tyro.cli(Options, description=__doc__)
    shown, is_thread, length = _lines(options.scenes, np.random.default_rng(options.seed))
    weights = _fitted(shown, is_thread, np.minimum(length, WHOLE_PX) / WHOLE_PX)
    print(f"{len(length)} lines, {is_thread.mean():.0%} of them thread: {np.round(weights, 2).tolist()}")
    if options.judged:
        _print_judged(*_lines(options.judged, np.random.default_rng(options.seed + 1)))


def worse(image: Image, rng: np.random.Generator) -> Image:
    """As a worse camera shows it: paler, in other light, out of focus, noisy, compressed; each at times."""
    seen = image.astype(np.float64) / 255
    grey = seen.mean(axis=2, keepdims=True)
    if rng.random() < 0.5:
        seen = grey + (seen - grey) * np.exp(rng.normal(0, 0.4))
    gain, gamma = np.exp(rng.normal(0, 0.15) + rng.normal(0, 0.1, 3)), np.exp(rng.normal(0, 0.22))
    seen = np.clip(gain * np.clip(seen, 0, 1) ** gamma + rng.uniform(-0.04, 0.06), 0, 1)
    if rng.random() < 0.6:
        seen = np.asarray(cv2.GaussianBlur(seen, (0, 0), rng.uniform(0.3, 1.4)))
    if rng.random() < 0.6:
        read, shot = rng.uniform(0, 6) / 255, rng.uniform(0, 9) / 255
        seen = seen + np.sqrt(read**2 + shot**2 * seen) * rng.normal(size=seen.shape)
    pixels = np.clip(255 * seen, 0, 255).astype(np.uint8)
    if rng.random() < 0.4:
        data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(40, 95))])[1]
        pixels = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    return pixels


def _lines(
    folders: Sequence[Path], rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "n k"], Bool[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """Of each line of all views what it shows, whether most of it is thread, and its length."""
    parts = list(_of_views(views_in(folders), rng))
    return (
        np.concatenate([shown for shown, _, _ in parts]),
        np.concatenate([is_thread for _, is_thread, _ in parts]),
        np.concatenate([length for _, _, length in parts]),
    )


def _of_views(
    views: list[View], rng: np.random.Generator
) -> Iterator[tuple[Float64[np.ndarray, "n k"], Bool[np.ndarray, "n"], Float64[np.ndarray, "n"]]]:
    for view in views:
        image = as_usual(view.image if rng.random() < AS_IT_IS else worse(view.image, rng))
        lines = lines_in(thread_score(image))
        coverage = cv2.resize(view.coverage, image.shape[1::-1], interpolation=cv2.INTER_AREA)
        side = 2 * BESIDE_PX + 1
        thread = np.asarray(cv2.dilate(coverage, np.ones((side, side), np.uint8))) >= COVERED
        count = len(lines.length_px)
        share = np.bincount(lines.line, thread.ravel()[lines.pixel], count) / np.maximum(
            np.bincount(lines.line, minlength=count), 1
        )
        long = lines.length_px >= SHORTEST_PX
        yield evidence(lines)[long], share[long] > 0.5, lines.length_px[long]


def _fitted(
    shown: Float64[np.ndarray, "n k"], is_thread: Bool[np.ndarray, "n"], counts: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "k"]:
    """The weights of what lines show, the last of which is always 1."""

    def loss(weights: Float64[np.ndarray, "k"]) -> float:
        odds = shown @ weights
        return float((counts * (np.logaddexp(0, odds) - is_thread * odds)).sum() + RIDGE * (weights[:-1] ** 2).sum())

    return np.asarray(minimize(loss, np.zeros(shown.shape[1])).x)


def _print_judged(
    shown: Float64[np.ndarray, "n k"], is_thread: Bool[np.ndarray, "n"], length: Float64[np.ndarray, "n"]
) -> None:
    """By the weights in use, in bins of probability: lines, what they are said to be, what they are; by length."""
    said = 1 / (1 + np.exp(-shown @ WEIGHTS))
    for low, high in itertools.pairwise(BINS):
        here = (said >= low) & (said <= high)
        if here.any():
            told, true = (np.average(each[here], weights=length[here]) for each in (said, is_thread))
            print(f"{low:.1f} to {high:.1f}: {here.sum()} lines, said {told:.2f}, thread {true:.2f}")


if __name__ == "__main__":
    main()
